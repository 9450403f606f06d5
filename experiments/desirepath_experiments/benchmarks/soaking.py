"""`desirepath benchmark soak`: rounds of participants against one server for as long as is asked, and whether it grows.

What one round is lives in `serving.py`.
"""

from __future__ import annotations

import contextlib
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from desirepath.cli.loopback import loopback_server
from desirepath_experiments.benchmarks.processes import family, family_mb, open_files, threads_of
from desirepath_experiments.benchmarks.serving import MOST_ANSWERS, PACE_S, installation, walk_everybody

LOOK_EVERY_S = 5.0
LOG_NAME = "server.log"


@dataclass(frozen=True)
class Look:
    """What the server and all that it started hold at one moment. at_s: since the beginning."""

    at_s: float
    memory_mb: float
    open_files: int
    threads: int


def benchmark_soak(
    *,
    sessions: int = 50,
    minutes: float = 30.0,
    processes: int = 1,
    answers: int = MOST_ANSWERS,
    pace_s: float = PACE_S,
    postgresql: bool = False,
    tell: Callable[[str], None] = lambda words: None,
) -> dict[str, Any]:
    """Let `sessions` participants answer, then as many fresh ones, until the minutes are over; a round ends whole.

    Returns per round (`rounds`): from_s, answers, p95_ack_ms and the medians of memory_mb, open_files and threads of
    the server's processes over the round; growth: of each per hour, by a straight line through the rounds but the
    first, in which things are loaded; quiet: the same three when everybody had left, after the first round and after
    the last. Raises as `benchmark_serve` does.
    """
    if minutes <= 0:
        raise ValueError(f"minutes = {minutes}: more than 0")
    rounds: list[dict[str, Any]] = []
    quiet: list[Look] = []
    with (
        tempfile.TemporaryDirectory(prefix="desirepath-soak-") as folder,
        installation(Path(folder), postgresql or processes > 1) as found,
    ):
        arguments = ("--processes", str(processes))
        log = Path(folder) / LOG_NAME
        with loopback_server(found.settings, worker=False, log=log, arguments=arguments) as (url, server):
            found.await_processes(processes)
            with _looking(server.pid) as (looks, began):
                while not rounds or time.monotonic() - began < minutes * 60:
                    first, from_s = len(looks), time.monotonic() - began
                    walked = walk_everybody(
                        found.database, url, server.pid, found.study, sessions, answers, pace_s, None
                    )
                    seen = looks[first:] or [_look(server.pid, began)]
                    rounds.append(
                        {
                            "from_s": round(from_s),
                            "answers": walked["answers_stored"],
                            "p95_ack_ms": walked["p95_ack_ms"],
                            "errors": walked["errors"],
                            "memory_mb": round(_middle([one.memory_mb for one in seen]), 1),
                            "open_files": round(_middle([one.open_files for one in seen])),
                            "threads": round(_middle([one.threads for one in seen])),
                        }
                    )
                    tell(f"round {len(rounds)}: {rounds[-1]}")
                    time.sleep(LOOK_EVERY_S)  # connections that were closed are gone by then
                    quiet.append(_look(server.pid, began))
                    tell(f"everybody has left: {_as_dict(quiet[-1])}")
    return {
        "sessions": sessions,
        "processes": processes,
        "minutes": round((quiet[-1].at_s) / 60, 1),
        "answers_stored": sum(one["answers"] for one in rounds),
        "pace_s": pace_s,
        "growth_per_hour": growth(rounds),
        "quiet": [_as_dict(one) for one in (quiet[0], quiet[-1])],
        "rounds": rounds,
    }


def growth(rounds: Sequence[dict[str, Any]]) -> dict[str, float] | None:
    """Of memory (MB), open files and threads per hour: the slope of a straight line by least squares through the rounds
    but the first; None where fewer than two are left."""
    later = rounds[1:]
    if len(later) < 2:
        return None
    hours = [one["from_s"] / 3600 for one in later]
    return {
        what: round(float(np.polyfit(hours, [one[what] for one in later], 1)[0]), 2)
        for what in ("memory_mb", "open_files", "threads")
    }


@contextlib.contextmanager
def _looking(pid: int) -> Iterator[tuple[list[Look], float]]:
    """Looks at a process and its family every few seconds, in a list that grows meanwhile; and when that began."""
    looks: list[Look] = []
    began, ended = time.monotonic(), threading.Event()

    def look() -> None:
        while not ended.wait(LOOK_EVERY_S):
            looks.append(_look(pid, began))

    thread = threading.Thread(target=look, daemon=True)
    thread.start()
    try:
        yield looks, began
    finally:
        ended.set()
        thread.join()


def _look(pid: int, began: float) -> Look:
    everyone = family(pid)
    return Look(
        time.monotonic() - began,
        family_mb(pid),
        sum(open_files(one) for one in everyone),
        sum(threads_of(one) for one in everyone),
    )


def _middle(values: Sequence[float]) -> float:
    return float(np.median(values))


def _as_dict(look: Look) -> dict[str, float]:
    return {"memory_mb": round(look.memory_mb, 1), "open_files": look.open_files, "threads": look.threads}
