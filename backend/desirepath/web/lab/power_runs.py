"""Power analyses of planned studies in the background, one after another; the latest are kept in memory. No route lives
here: they are `power_pages.py`'s. What is computed is `desirepath studies power`'s.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic.fields import FieldInfo

from desirepath.grammar.configuration import limits_of, read_fields
from desirepath.jobs.process import ONE_THREAD, environment_of
from desirepath.report.planned_design import Assumed
from desirepath.settings import Settings
from desirepath.store.database import is_full

MOST_KEPT = 16
MOST_WAITING = 4
NICENESS = 10  # after everything else: it takes minutes, and nobody's answer waits for it
LONGEST_S = 3_600.0
FILES = ("power.svg", "power.png", "power.csv")
FEWEST, MOST = 3, 500  # participants
MOST_SIZES = 6
_SIZE = re.compile(r"of (\d+) participants")  # in what the command tells


@dataclass(frozen=True)
class Number:
    """One number that is assumed. usual: the command's own default, None: none; step: of the form's field."""

    usual: float | None
    low: float
    high: float
    step: float = 0.05

    @property
    def whole(self) -> bool:
        return self.step == 1


PLACES = ("condition", "item", "ranking")
"""Where the effect is, as the command's options name it; left out, the command takes the last, the first, the first."""
FINE = ("first_choice", "tau", "tau_gain")


def _number(name: str, field: FieldInfo) -> Number:
    low, high = limits_of(field)
    return Number(field.default, low or 0, 3 if high is None else high, 0.01 if name in FINE else 0.05)


NUMBERS: dict[str, Number] = {
    **{n: _number(n, field) for n, field in read_fields(Assumed).items() if n not in (*PLACES, "seed")},
    "cohorts": Number(500, 20, 1000, 1),
}
"""In the words of the command's options, which say what each means."""
COHORTS = (
    200  # ours: what the page offers; the command's 500 take minutes more and tell a power to 0.04 instead of 0.07
)


class PowerAskedError(ValueError):
    """A field that cannot be. name: of the field; low, high: what it can be between, None where it is one of a list."""

    def __init__(self, name: str, low: float | None = None, high: float | None = None) -> None:
        self.name, self.low, self.high = name, low, high
        super().__init__(f"{name} is none of the protocol's" if low is None else f"{name} lies outside {low} to {high}")


@dataclass(frozen=True)
class PowerAsked:
    """What is asked of one protocol. numbers: in the order of NUMBERS, those that are not the usual
    ones. places: where the effect is, in the order of PLACES, those that were chosen."""

    participants: tuple[int, ...] = (10, 20, 30, 40)
    numbers: tuple[tuple[str, float], ...] = (("cohorts", COHORTS),)
    places: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of(cls, given: Mapping[str, str], there: Mapping[str, Collection[str]]) -> PowerAsked:
        """As a form or an address gives it. there: what each of PLACES can be. Raises PowerAskedError."""
        places = [(name, chosen) for name in PLACES if (chosen := given.get(name, "").strip())]
        for name, chosen in places:
            if chosen not in there.get(name, ()):
                raise PowerAskedError(name)
        return cls(_sizes(given.get("participants", "")), tuple(_numbers(given)), tuple(places))

    @property
    def query(self) -> dict[str, str]:
        """The same as `of` reads it."""
        numbers = {name: f"{value:g}" for name, value in self.numbers}
        return {"participants": ",".join(map(str, self.participants)), **numbers, **dict(self.places)}

    @property
    def options(self) -> list[str]:
        """For the command, without what it assumes anyway."""
        found = ["--participants", ",".join(map(str, self.participants))]
        for name, value in self.numbers:
            if value != NUMBERS[name].usual:
                found += [f"--{name.replace('_', '-')}", f"{value:g}"]
        for name, chosen in self.places:
            found += [f"--{name}", chosen]
        return found

    def command(self, study: str) -> str:
        """study: its id, or a protocol file."""
        return shlex.join(["desirepath", "studies", "power", study, *self.options])


def _sizes(given: str) -> tuple[int, ...]:
    if not given.strip():
        return PowerAsked.participants
    words = [word for word in re.split(r"[,;\s]+", given.strip()) if word]
    sizes = sorted({int(word) for word in words if word.isascii() and word.isdecimal() and len(word) < 6})
    if len(sizes) < len(set(words)) or not 0 < len(sizes) <= MOST_SIZES or not FEWEST <= sizes[0] <= sizes[-1] <= MOST:
        raise PowerAskedError("participants", FEWEST, MOST)
    return tuple(sizes)


def _numbers(given: Mapping[str, str]) -> list[tuple[str, float]]:
    found = []
    for name, number in NUMBERS.items():
        text = given.get(name, "").strip().replace(",", ".")
        if not text:
            if name == "cohorts":
                found.append((name, float(COHORTS)))
            continue
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not number.low <= value <= number.high or (number.whole and value != int(value)):
            raise PowerAskedError(name, number.low, number.high)
        if value != number.usual or name == "cohorts":
            found.append((name, value))
    return found


@dataclass
class PowerRun:
    """One analysis. state: waiting, walking (bots through the study), counting, ready or failed; at: how many
    participants the studies have that are made up now; result: the command's result; files: name -> content."""

    asked: PowerAsked
    state: str = "waiting"
    at: int = 0
    result: dict[str, Any] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    problem: str = ""

    @property
    def over(self) -> bool:
        return self.state in ("ready", "failed")

    @property
    def tests(self) -> dict[str, dict[int, dict[str, Any]]]:
        """Test -> number of participants -> power with its interval."""
        found: dict[str, dict[int, dict[str, Any]]] = {}
        for row in self.result.get("rows", []):
            found.setdefault(row["test"], {})[row["participants"]] = row
        return found

    @property
    def share(self) -> float:
        """How much of it is done, roughly: a larger study takes longer."""
        before = sum(size for size in self.asked.participants if size < self.at)
        return before / sum(self.asked.participants)


class TooManyError(RuntimeError):
    """So many are waiting already that another one would not be begun for long."""


class PowerRuns:
    """The analyses of one server. Methods may be called from any thread."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._turn = threading.Lock()
        self._known: OrderedDict[tuple[str, PowerAsked], PowerRun] = OrderedDict()

    def find(self, protocol: str, asked: PowerAsked) -> PowerRun | None:
        """protocol: its hash."""
        with self._lock:
            return self._known.get((protocol, asked))

    def newest(self, protocol: str) -> PowerRun | None:
        """Whatever was asked last of the protocol with that hash."""
        with self._lock:
            return next((run for (known, _), run in reversed(self._known.items()) if known == protocol), None)

    def begin(self, protocol: str, asked: PowerAsked, source: str | Path) -> PowerRun:
        """The analysis of a protocol; begun where it is not known, or failed. source: a study's id, or the folder of a
        draft, which is copied: what is edited meanwhile does not matter. Raises TooManyError."""
        with self._lock:
            found = self._known.get((protocol, asked))
            if found is not None and found.state != "failed":
                return found
            if sum(not run.over for run in self._known.values()) > MOST_WAITING:
                raise TooManyError
            begun = self._known[protocol, asked] = PowerRun(asked)
            over = [key for key, one in self._known.items() if one.over]
            for key in over[: max(0, len(self._known) - MOST_KEPT)]:
                del self._known[key]
        try:
            folder = tempfile.TemporaryDirectory(prefix="desirepath-power-")
            if isinstance(source, Path):
                shutil.copytree(source, Path(folder.name) / "protocol")
            threading.Thread(target=self._run, args=(begun, source, folder), daemon=True).start()
        except OSError as problem:  # the disk is full, or the draft has just been opened as a study
            begun.problem, begun.state = str(problem), "failed"
            if is_full(problem):
                raise
        return begun

    def _run(self, run: PowerRun, source: str | Path, folder: tempfile.TemporaryDirectory[str]) -> None:
        try:
            with folder as name, self._turn:
                study = source if isinstance(source, str) else str(Path(name) / "protocol" / "protocol.yaml")
                self._carry_out(run, study, Path(name))
            run.state = "ready"
        except Exception as problem:  # whatever it was: somebody looks at this page
            run.problem, run.state = str(problem), "failed"

    def _carry_out(self, run: PowerRun, study: str, folder: Path) -> None:
        out, answer_file = folder / "out", folder / "answer.json"
        asked = ["studies", "power", study, *run.asked.options, "--out", str(out), "--json"]
        run.state = "walking"
        with answer_file.open("wb") as answer:
            child = subprocess.Popen(
                [sys.executable, "-m", "desirepath.cli.ends_with_parent", *asked],
                stdin=subprocess.PIPE,  # nothing is ever written: it closes with this process
                stdout=answer,
                stderr=subprocess.PIPE,
                text=True,
                env=environment_of(self._settings) | ONE_THREAD,
                start_new_session=True,
            )
        os.setpriority(os.PRIO_PROCESS, child.pid, NICENESS)
        watchdog = threading.Timer(LONGEST_S, child.kill)
        watchdog.daemon = True
        watchdog.start()
        try:
            for line in child.stderr or ():
                if size := _SIZE.search(line):
                    run.state, run.at = "counting", int(size[1])
            child.wait()
        finally:
            watchdog.cancel()
            child.kill()
            child.wait()
        try:
            run.result = json.loads(answer_file.read_bytes())
        except ValueError:
            raise RuntimeError("the process ended without an answer") from None
        if child.returncode:
            raise RuntimeError(str(run.result.get("error", "the process ended without an answer")))
        run.files = {name: (out / name).read_bytes() for name in FILES}
