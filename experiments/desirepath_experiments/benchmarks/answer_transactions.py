"""`python -m desirepath_experiments.benchmarks.answer_transactions FILE`: one connection of `database_writes.py`.

Says the statements of one participant's answer again and again, each time for the next pair of a session of its own.
Loads nothing but the database's client, so that as little as may be of the machine's processor is its own.
"""

from __future__ import annotations

import pickle
import sys
import time
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psycopg

READY = "ready"
Statement = tuple[str, dict[str, Any]]


@dataclass(frozen=True)
class Recorded:
    """The statements of one answer's transaction, and the values in them that belong to the session and pair that it
    was recorded of."""

    statements: list[Statement]
    session: str
    token_hash: str
    participant: str
    position: int
    answered_trial: str
    answered_step: str
    next_trial: str
    next_step: str
    response: str
    request: str


@dataclass(frozen=True)
class OwnSession:
    """A copy of the recorded session as it was before the answer, for one connection alone."""

    session: str
    token_hash: str
    participant: str
    first_trial: str


@dataclass(frozen=True)
class Connection:
    """What one connection is to do. answers: of each session; seconds: after which it ends."""

    address: str
    recorded: Recorded
    sessions: list[OwnSession]
    answers: int
    seconds: float


def answer(connection: psycopg.Connection[Any], recorded: Recorded, own: OwnSession, number: int, trial: str) -> str:
    """Answer pair `number` of a session, which the trial is of; returns the next pair's trial."""
    fresh = uuid.uuid4().hex
    instead = {
        recorded.session: own.session,
        recorded.token_hash: own.token_hash,
        recorded.participant: own.participant,
        recorded.answered_trial: trial,
        recorded.answered_step: f"answered.{number}",
        recorded.next_trial: fresh,
        recorded.next_step: f"answered.{number + 1}",
        recorded.response: uuid.uuid4().hex,
        recorded.request: uuid.uuid4().hex,
        "choosing": "ready",  # these pairs are answered without having been watched
    }
    moved = {"position": number + 1, "position_1": number, "index": number + 1}
    for statement, values in recorded.statements:
        said = {
            name: moved[name] if name in moved else instead.get(value, value) if isinstance(value, str) else value
            for name, value in values.items()
        }
        done = connection.execute(statement, said)
        if statement.startswith("UPDATE") and done.rowcount != 1:
            raise RuntimeError(f"{statement[:60]}: changed {done.rowcount} rows instead of one")
    connection.commit()
    return fresh


def work(given: Connection) -> tuple[float, list[float]]:
    """Returns the seconds that it took and the milliseconds of each answer."""
    took: list[float] = []
    with psycopg.connect(given.address) as connection:
        print(READY, flush=True)
        sys.stdin.readline()  # all begin at once
        began = time.perf_counter()
        for own in given.sessions:
            trial = own.first_trial
            for number in range(given.answers):
                asked = time.perf_counter()
                if asked - began >= given.seconds:
                    return asked - began, took
                trial = answer(connection, given.recorded, own, number, trial)
                took.append((time.perf_counter() - asked) * 1000)
        return time.perf_counter() - began, took


def main(files: Sequence[str]) -> None:
    """Do what the file says and write into it what came of it."""
    file = Path(files[0])
    given = pickle.loads(file.read_bytes())  # noqa: S301  written by our own parent process
    file.write_bytes(pickle.dumps(work(given)))


if __name__ == "__main__":
    # Pickles name this module as its parent loaded it.
    from desirepath_experiments.benchmarks import answer_transactions

    answer_transactions.main(sys.argv[1:])
