"""Work that survives being killed: pieces, each stored in one file named by the hash of all that its result depends on.

What the pieces of a chapter compute lives in that chapter's module; here live storing, ordering and running them.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from multiprocessing.connection import wait as wait_for
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from backend.learning.cards import source_commit
from backend.simulation.npz import from_npz, to_npz

FORMAT = "desirepath-piece-1"
PARTIAL = ".partial"


@dataclass(frozen=True)
class Piece:
    """One piece of work. kind: the name of its function. params: JSON-ready, everything else its result depends on.

    needs: pieces whose results the function is given. seconds: about how long it takes, only for telling and for
    starting the longest first; no part of its identity.
    """

    kind: str
    params: dict[str, Any]
    needs: tuple[Piece, ...] = ()
    seconds: float = 0.0

    @property
    def key(self) -> str:
        """Kind and hash: the name of its file."""
        identity = {
            "format": FORMAT,
            "kind": self.kind,
            "params": self.params,
            "needs": [need.key for need in self.needs],
        }
        digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
        return f"{self.kind}-{digest[:20]}"


@dataclass(frozen=True)
class Made:
    """What a piece of work came to: plain values and arrays. `meta` gets `made` (seconds, commit, date) when stored."""

    meta: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


Function = Callable[[dict[str, Any], Sequence[Made]], Made]
"""(params, results of the needs) -> result; runs in any process, so it must be a module's function."""


class Work:
    """The folder of finished pieces. A file that is there is whole: it is written beside and renamed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, piece_key: str) -> Path:
        return self.folder / f"{piece_key}.npz"

    def has(self, piece: Piece) -> bool:
        return self.path(piece.key).is_file()

    def load(self, piece_key: str) -> Made:
        """Never unpickles."""
        return Made(*from_npz(self.path(piece_key).read_bytes()))

    def store(self, piece_key: str, made: Made) -> None:
        partial = self.folder / f"{piece_key}.{os.getpid()}{PARTIAL}"
        with partial.open("wb") as file:
            file.write(to_npz(made.meta, made.arrays))
            file.flush()
            os.fsync(file.fileno())
        partial.replace(self.path(piece_key))

    @contextmanager
    def claimed(self) -> Iterator[None]:
        """This process alone works here; the claim ends with the process, however it ends. Raises RuntimeError."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with (self.folder / "claim").open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise RuntimeError(
                    f"{self.folder.parent}: another run works there; wait for it or use another --out"
                ) from None
            for left in self.folder.glob(f"*{PARTIAL}"):
                left.unlink()
            yield


def finish_piece(functions: Mapping[str, Function], folder: Path, piece: Piece) -> float:
    """Compute and store one piece whose needs are stored; returns its seconds. Runs in any process."""
    work = Work(folder)
    began, cpu = time.perf_counter(), time.process_time()
    made = functions[piece.kind](piece.params, [work.load(need.key) for need in piece.needs])
    seconds = time.perf_counter() - began
    about = {
        "seconds": seconds,
        "cpu_seconds": time.process_time() - cpu,
        "commit": source_commit(),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    work.store(piece.key, Made({**made.meta, "kind": piece.kind, "params": piece.params, "made": about}, made.arrays))
    return seconds


@dataclass(frozen=True)
class Run:
    """The run that made a report. made: what `pieces` stored about each piece (seconds, commit, date), by key."""

    command: str
    commit: str
    processes: int
    seconds: float
    computed: int
    made: Mapping[str, Mapping[str, Any]]

    @property
    def core_seconds(self) -> float:
        """Of one core, for all pieces, whenever they were computed."""
        return sum(float(about["cpu_seconds"]) for about in self.made.values())


def in_order(pieces: Sequence[Piece]) -> list[Piece]:
    """These pieces and all they need, each once, needs first."""
    found: dict[str, Piece] = {}

    def take(piece: Piece) -> None:
        for need in piece.needs:
            take(need)
        found.setdefault(piece.key, piece)

    for piece in pieces:
        take(piece)
    return list(found.values())


OnPiece = Callable[[Piece, int, int, float], None]
"""(piece just finished, finished so far, all to do, seconds that the rest will take, about)."""


def finish(
    pieces: Sequence[Piece],
    functions: Mapping[str, Function],
    work: Work,
    *,
    processes: int,
    on_piece: OnPiece,
) -> int:
    """Compute what is not stored yet, in `processes` processes of one thread each; returns how many were computed.

    One process means this one. Raises what a piece raised; finished pieces stay.
    """
    if processes < 1:
        raise ValueError(f"processes = {processes}: at least 1")
    missing = [piece for piece in in_order(pieces) if not work.has(piece)]
    progress = _Progress(missing, processes, on_piece)
    if processes == 1:
        for piece in missing:
            progress.count(piece, finish_piece(functions, work.folder, piece))
        return len(missing)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context, initializer=_end_with_parent) as pool:
        waiting, running = list(missing), dict[Future[float], Piece]()
        while waiting or running:
            ready = [piece for piece in waiting if all(work.has(need) for need in piece.needs)]
            for piece in sorted(ready, key=lambda p: -p.seconds)[: processes - len(running)]:
                waiting.remove(piece)
                running[pool.submit(finish_piece, functions, work.folder, piece)] = piece
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                progress.count(running.pop(future), future.result())
    return len(missing)


class _Progress:
    """Corrects the estimate of what is left by how long the finished pieces took."""

    def __init__(self, pieces: Sequence[Piece], processes: int, on_piece: OnPiece) -> None:
        self._todo, self._processes, self._on_piece = len(pieces), processes, on_piece
        self._left = sum(piece.seconds for piece in pieces)
        # As if a tenth of the work had been done in the time estimated: the first, small pieces say little.
        self._done, self._estimated, self._took = 0, self._left / 10, self._left / 10

    def count(self, piece: Piece, seconds: float) -> None:
        self._done += 1
        self._left -= piece.seconds
        self._estimated += piece.seconds
        self._took += seconds
        slower = self._took / self._estimated if self._estimated else 1.0
        self._on_piece(piece, self._done, self._todo, max(0.0, self._left) * slower / self._processes)


def _end_with_parent() -> None:
    """A worker whose parent was killed would wait for work for ever; this one ends instead."""
    parent = multiprocessing.parent_process()
    assert parent is not None  # noqa: S101 - only ever called in a child

    def watch() -> None:
        wait_for([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
