"""Makes whole reports of studies in the background, one after another, and keeps the latest in memory. No route lives
here: they are `analysis_pages.py`'s.

A report that is being made is waited for, whatever is answered meanwhile. One that is there is shown until somebody who
is in it was erased, excluded or withdrew: answers that came since only make it old, and it says so.
"""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import tempfile
import threading
import zipfile
from collections import OrderedDict
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.jobs.process import ONE_THREAD, environment_of
from desirepath.settings import Settings
from desirepath.store.models import Participant, Response, Session, Study, utc_now

MOST_KEPT = 8  # reports; about five MB each
NICENESS = 5  # as figures: an analyst waits for it, but everything of participants goes first
LONGEST_S = 600.0


class ReportError(RuntimeError):
    """A report that could not be made; says why, for people."""


@dataclass(frozen=True)
class ReportFiles:
    """A report's files: path within the report -> content."""

    files: dict[str, bytes]

    def as_zip(self) -> bytes:
        """All of it, to be taken away; the same report gives the same bytes."""
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as packed:
            for name, content in sorted(self.files.items()):
                packed.writestr(zipfile.ZipInfo(f"report/{name}"), content)
        return out.getvalue()


@dataclass(frozen=True)
class MadeFrom:
    """What a report is made from. people: (code, excluded at, withdrawn at) of everybody who has joined."""

    answers: int
    completed: int
    protocol: str
    people: frozenset[tuple[str, datetime | None, datetime | None]]

    @classmethod
    def of(cls, s: DatabaseSession, study: Study) -> MadeFrom:
        """As the study stands now."""
        answers = s.scalar(select(func.count()).select_from(Response).join(Session).where(Session.study_id == study.id))
        ended = select(func.count()).where(Session.study_id == study.id, Session.state == "completed")
        people = select(Participant.code, Participant.excluded_at, Participant.withdrawn_at)
        found = s.execute(people.where(Participant.study_id == study.id))
        everybody = frozenset((code, excluded, withdrawn) for code, excluded, withdrawn in found)
        return cls(answers or 0, s.scalar(ended) or 0, study.protocol_hash, everybody)


@dataclass(frozen=True)
class WholeReport:
    """A report that is there or being made; `asked_at`: since when."""

    files: Future[ReportFiles]
    made_from: MadeFrom
    asked_at: datetime

    @property
    def ready(self) -> bool:
        return self.files.done()

    @property
    def problem(self) -> BaseException | None:
        """Why there is none, where it could not be made."""
        return self.files.exception() if self.files.done() else None

    def may_be_shown(self, now: MadeFrom) -> bool:
        """Whether all whose answers are in it are still there, and as they were."""
        return self.made_from.people <= now.people


class Reports:
    """One report for each study and kind of participants."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._turn = threading.Lock()
        self._known: OrderedDict[tuple[str, str], WholeReport] = OrderedDict()

    def ask(self, study: str, who: str, now: MadeFrom, *, recompute: bool = False) -> WholeReport:
        """The report of these people; begun where there is none to show. recompute: also where answers came since."""
        with self._lock:
            found = self._known.get((study, who))
            if found is not None and (
                not found.ready or (found.may_be_shown(now) and not self._is_old(found, now, recompute))
            ):
                return found
            begun = self._known[study, who] = WholeReport(Future(), now, utc_now())
            self._known.move_to_end((study, who))
            threading.Thread(target=self._make, args=(begun.files, study, who), daemon=True).start()
            for key in [key for key, one in self._known.items() if one.ready][: len(self._known) - MOST_KEPT]:
                del self._known[key]
        return begun

    def there(self, study: str, who: str, now: MadeFrom) -> ReportFiles | None:
        """The files of the report that may be shown now, None where there is none; begins nothing."""
        with self._lock:
            found = self._known.get((study, who))
        if found is None or not found.ready or found.problem is not None or not found.may_be_shown(now):
            return None
        return found.files.result()

    @staticmethod
    def _is_old(found: WholeReport, now: MadeFrom, recompute: bool) -> bool:
        return found.made_from != now and (recompute or found.problem is not None)

    def _make(self, promised: Future[ReportFiles], study: str, who: str) -> None:
        try:
            with self._turn:
                promised.set_result(self.remake(study, who))
        except Exception as problem:  # whatever it was: somebody waits for this promise
            promised.set_exception(ReportError(str(problem)))

    def remake(self, study: str, who: str) -> ReportFiles:
        with tempfile.TemporaryDirectory() as folder:
            asked = ["studies", "report", study, "--who", who, "--out", folder, "--json"]
            command = [sys.executable, "-m", "desirepath", *asked]
            child = subprocess.Popen(
                command,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=environment_of(self._settings) | ONE_THREAD,
            )
            os.setpriority(os.PRIO_PROCESS, child.pid, NICENESS)
            try:
                output, _ = child.communicate(timeout=LONGEST_S)
            finally:
                if child.poll() is None:
                    child.kill()
                    child.wait()
            if child.returncode:
                raise ReportError(_error_in(output))
            root = Path(folder)
            return ReportFiles({f.relative_to(root).as_posix(): f.read_bytes() for f in root.rglob("*") if f.is_file()})


def _error_in(output: bytes) -> str:
    try:
        return str(json.loads(output)["error"])
    except (ValueError, KeyError, TypeError):
        return "the process ended without an answer"
