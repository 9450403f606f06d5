"""What every chapter's run shares: telling how long, computing the pieces, the file of results. Clocks live here."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from backend.experiments.reproduction.tasks import Function, Piece, Run, Work, finish, in_order
from backend.learning.cards import source_commit

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Estimate:
    """What is left to do. core_seconds: of one core of this machine, about, when nothing else runs on it."""

    pieces: int
    stored: int
    core_seconds: float

    def in_words(self, processes: int) -> str:
        if self.pieces == self.stored:
            return f"All {self.pieces} pieces are stored already."
        return (
            f"{self.pieces - self.stored} of {self.pieces} pieces to compute, about {told_time(self.core_seconds)} of "
            f"one core; with {processes} processes about {told_time(self.core_seconds / processes)} if each has a core."
        )


def told_time(seconds: float) -> str:
    """Minutes up to two hours, then hours."""
    return f"{math.ceil(seconds / 60)} min" if seconds < 7_200 else f"{seconds / 3_600:.1f} h"


def estimate(wanted: Sequence[Piece], work: Work) -> Estimate:
    """What these pieces and those they need still take."""
    pieces = in_order(wanted)
    missing = [piece for piece in pieces if not work.has(piece)]
    return Estimate(len(pieces), len(pieces) - len(missing), sum(piece.seconds for piece in missing))


def compute(
    wanted: Sequence[Piece],
    functions: Mapping[str, Function],
    work: Work,
    *,
    command: str,
    processes: int,
    tell: Tell,
    name: Callable[[Piece], str],
) -> Run:
    """Compute what is missing of these pieces and those they need, telling `name` of each when it is finished.

    Raises ValueError for a number of processes that cannot be.
    """
    # numba and BLAS read these when a process begins; pieces are computed one thread each
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    began = time.perf_counter()
    tell(estimate(wanted, work).in_words(processes))

    def told(piece: Piece, done: int, todo: int, left: float) -> None:
        tell(f"[{done}/{todo}] {name(piece)}; about {told_time(left)} left")

    computed = finish(wanted, functions, work, processes=processes, on_piece=told)
    made = {piece.key: work.load(piece.key).meta["made"] for piece in in_order(wanted)}
    return Run(command, source_commit(), processes, time.perf_counter() - began, computed, made)


def write_results(path: Path, run: Run, budget: DataclassInstance, **results: Any) -> dict[str, Any]:
    """Write results.json: run, budget, `results` and what is known of every piece. Returns what stands in it."""
    told = {
        "command": run.command,
        "commit": run.commit,
        "budget": asdict(budget),
        "processes": run.processes,
        "seconds": run.seconds,
        "computed": run.computed,
        "core_seconds": run.core_seconds,
        "simulated": True,
        **results,
        "pieces": run.made,
    }
    path.write_text(json.dumps(plain(told), indent=1) + "\n", encoding="utf-8")
    return told


def plain(value: Any) -> Any:
    """JSON has no NaN: null instead."""
    if isinstance(value, dict):
        return {key: plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
