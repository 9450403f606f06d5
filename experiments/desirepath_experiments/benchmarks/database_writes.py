"""`desirepath benchmark database`: the transaction of one answer from many connections, as fast as PostgreSQL takes it.

Nothing of the server runs: what is measured is where the database alone would stop an installation from growing. What
one connection does lives in `answer_transactions.py`.
"""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import tempfile
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from psycopg.types.json import Json
from sqlalchemy import event, insert, select, text

from desirepath.store.database import Database
from desirepath.store.models import Participant, Session, Trial
from desirepath.study.simulated.in_process import walk_in_process
from desirepath_experiments.benchmarks.answer_transactions import READY, Connection, OwnSession, Recorded, Statement
from desirepath_experiments.benchmarks.processes import family_ever_s
from desirepath_experiments.benchmarks.serving import MOST_ANSWERS, BenchmarkInstallation, installation
from desirepath_experiments.own_postgres import own_postgres_pid

MOST_PER_S = 1_500  # sessions are prepared for so many answers a second; a faster machine ends a run early
PATIENCE_S = 60.0


class DatabaseBenchmarkError(RuntimeError):
    """An answer could not be stored, or none was recorded."""


def benchmark_database(
    *,
    connections: Sequence[int] = (1, 2, 4, 8, 16),
    seconds: float = 5.0,
    tell: Callable[[str], None] = lambda words: None,
) -> dict[str, Any]:
    """Store answers from so many connections at once, for so many seconds each. Every commit waits for the disk.

    Returns {"statements" of one answer, "runs": by number of connections answers_per_s, p50_ms and p95_ms of one,
    database_ms_per_answer (processor time of PostgreSQL's processes) and log_kb_per_answer (write-ahead log), "cores",
    "load_average"}. The connections' own processes run on the same cores, so what is measured is the least that the
    database can do. Raises DatabaseBenchmarkError, ValueError, NoPostgres.
    """
    if not connections or min(connections) < 1 or seconds <= 0:
        raise ValueError(f"connections = {list(connections)}, seconds = {seconds}: at least 1, and more than 0")
    load = [round(value, 2) for value in os.getloadavg()]
    with tempfile.TemporaryDirectory(prefix="desirepath-database-") as name, installation(Path(name), True) as found:
        recorded = record_answer(found)
        runs = []
        for number in connections:
            runs.append(_run(found.database, recorded, Path(name), number, seconds))
            tell(f"{runs[-1]}")
    return {
        "statements": len(recorded.statements),
        "seconds": seconds,
        "runs": runs,
        "cores": os.cpu_count(),
        "load_average": load,
    }


def record_answer(found: BenchmarkInstallation) -> Recorded:
    """What a participant's answer to a pair, after which another pair is shown, says to the database."""
    transactions: list[list[Statement]] = [[]]

    def said(_connection: Any, _cursor: Any, statement: str, values: Any, _context: Any, _many: bool) -> None:
        transactions[-1].append((statement, values))

    def over(_connection: Any) -> None:
        transactions.append([])

    engine = found.database.engine
    listening = (("before_cursor_execute", said), ("commit", over), ("rollback", over))
    for what, heard in listening:
        event.listen(engine, what, heard)
    try:
        walk_in_process(found.database, found.files, found.study, 1, without_jobs=True)
    finally:
        for what, heard in listening:
            event.remove(engine, what, heard)
    try:
        return next(one for one in map(_recorded, transactions) if one is not None)
    except StopIteration:
        raise DatabaseBenchmarkError("the quick protocol's walk had no answer after which a pair was chosen") from None


def _recorded(statements: list[Statement]) -> Recorded | None:
    """None for a transaction of something else."""

    def values(begin: str, **wanted: str) -> dict[str, Any]:
        return next(
            (v for said, v in statements if said.startswith(begin) and all(v.get(k) == w for k, w in wanted.items())),
            {},
        )

    response, trial = values("INSERT INTO response", kind="preference"), values("INSERT INTO trial", kind="query")
    moved = values("UPDATE session SET position")
    found = values("SELECT session.id")
    consented = next((v for _, v in statements if "participant_id_1" in v), {})
    if not (response and trial and moved and found and consented):
        return None
    return Recorded(
        statements=[(said, {k: _plain(v) for k, v in values.items()}) for said, values in statements],
        session=response["session_id"],
        token_hash=found["token_hash_1"],
        participant=consented["participant_id_1"],
        position=moved["position_1"],
        answered_trial=response["trial_id"],
        answered_step=response["step_key"],
        next_trial=trial["id"],
        next_step=trial["step_key"],
        response=response["id"],
        request=response["request_id"],
    )


def _plain(value: Any) -> Any:
    """A value that any process can read again."""
    return json.dumps(value.obj) if isinstance(value, Json) else value


def _run(database: Database, recorded: Recorded, folder: Path, connections: int, seconds: float) -> dict[str, Any]:
    each = max(1, round(MOST_PER_S * seconds / MOST_ANSWERS / connections))
    own = _sessions(database, recorded, each * connections)
    processes: list[tuple[Path, subprocess.Popen[str]]] = []
    for number in range(connections):
        file = folder / f"connection-{connections}-{number}"
        sessions = own[number * each : (number + 1) * each]
        address = database.url.set(drivername="postgresql").render_as_string(hide_password=False)
        given = Connection(address, recorded, sessions, MOST_ANSWERS, seconds)
        file.write_bytes(pickle.dumps(given))
        command = [sys.executable, "-m", "desirepath_experiments.benchmarks.answer_transactions", str(file)]
        pipe = subprocess.PIPE
        processes.append((file, subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)))
    for _, process in processes:
        if process.stdout is None or process.stdout.readline().strip() != READY:
            raise DatabaseBenchmarkError(process.communicate()[1][-400:])
    used, written = _used(database)
    for _, process in processes:
        if process.stdin is not None:
            process.stdin.write("\n")
            process.stdin.flush()
    for _, process in processes:
        _, problem = process.communicate(timeout=PATIENCE_S + seconds)
        if process.returncode != 0:
            raise DatabaseBenchmarkError(problem[-400:])
    used_after, written_after = _used(database)
    ended = [pickle.loads(file.read_bytes()) for file, _ in processes]  # noqa: S301  written by our own processes
    took = np.concatenate([one[1] for one in ended])
    return {
        "connections": connections,
        "answers_per_s": round(sum(len(one[1]) / one[0] for one in ended), 1),
        "p50_ms": round(float(np.percentile(took, 50)), 1),
        "p95_ms": round(float(np.percentile(took, 95)), 1),
        "database_ms_per_answer": round((used_after - used) * 1000 / len(took), 2),
        "log_kb_per_answer": round((written_after - written) / 1024 / len(took), 2),
    }


def _used(database: Database) -> tuple[float, int]:
    """Seconds of processor and bytes of write-ahead log of the server so far."""
    with database.session() as s:
        written = s.scalar(text("SELECT pg_current_wal_lsn() - '0/0'::pg_lsn"))
    return family_ever_s(own_postgres_pid(str(database.url.query["host"]))), int(written or 0)


def _sessions(database: Database, recorded: Recorded, number: int) -> list[OwnSession]:
    """So many copies of the recorded session and its participant, before the first answer."""
    with database.transaction() as s:

        def row_of(table: Any, identity: str) -> dict[str, Any]:
            return dict(s.execute(select(table.__table__).where(table.__table__.c.id == identity)).mappings().one())

        participant = row_of(Participant, recorded.participant)
        session, trial = row_of(Session, recorded.session), row_of(Trial, recorded.answered_trial)
        own = [OwnSession(*(uuid.uuid4().hex for _ in range(4))) for _ in range(number)]
        s.execute(
            insert(Participant),
            [participant | {"id": one.participant, "code": one.participant[:12]} for one in own],
        )
        asked = {"state": "active", "position": 0}
        s.execute(
            insert(Session),
            [
                session | asked | {"id": one.session, "participant_id": one.participant, "token_hash": one.token_hash}
                for one in own
            ],
        )
        first = {"phase": "ready", "step_key": "answered.0", "index": 0}
        s.execute(
            insert(Trial),
            [trial | first | {"id": one.first_trial, "session_id": one.session} for one in own],
        )
    return own
