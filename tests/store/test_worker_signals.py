"""Workers are told of committed jobs and of participants, by pipe and by NOTIFY."""

from __future__ import annotations

import os
import queue
from collections.abc import Callable, Iterator

import pytest

from desirepath.store.database import Database
from desirepath.store.outbox import enqueue_job
from desirepath.store.worker_signals import Signal, SignalListener, remove_silent_pipes, signal_workers

PATIENCE_S = 30
Heard = queue.SimpleQueue[Signal]
Listen = Callable[[Database, str], Heard]


@pytest.fixture
def listen() -> Iterator[Listen]:
    """Begin to listen to a database as the worker of that name."""
    listeners = []

    def begin(database: Database, name: str) -> Heard:
        heard: Heard = queue.SimpleQueue()
        listeners.append(SignalListener(database, name, heard.put))
        listeners[-1].start()
        if not database.is_sqlite:
            assert heard.get(timeout=PATIENCE_S) is Signal.JOB_QUEUED, "one may have been told before"
        return heard

    yield begin
    for listener in listeners:
        listener.close()


def test_every_worker_hears_once_of_what_a_transaction_committed(either, listen):
    either.migrate()
    workers = [listen(either, name) for name in ("one", "two")]
    with either.transaction() as s:
        signal_workers(s, Signal.PARTICIPANT_PRESENT)
        s.rollback()
    with either.transaction() as s:
        for _ in range(3):
            enqueue_job(s, "evaluate", {})
        assert all(worker.empty() for worker in workers), "nothing is told before the commit"
    assert [worker.get(timeout=PATIENCE_S) for worker in workers] == [Signal.JOB_QUEUED] * 2
    with either.transaction() as s:
        signal_workers(s, Signal.PARTICIPANT_PRESENT)
    assert [worker.get(timeout=PATIENCE_S) for worker in workers] == [Signal.PARTICIPANT_PRESENT] * 2
    assert all(worker.empty() for worker in workers)


def test_what_killed_workers_and_backups_leave_hinders_nobody(database, listen):
    left, copied = (database.file.with_name(f"{database.file.name}.worker-{name}") for name in ("left", "copied"))
    os.mkfifo(left)
    copied.write_text("no pipe: out of a backup")
    heard = listen(database, "copied")
    assert copied.is_fifo()
    with database.transaction() as s:
        enqueue_job(s, "evaluate", {})
    assert heard.get(timeout=PATIENCE_S) is Signal.JOB_QUEUED
    remove_silent_pipes(database)
    assert not left.exists()
    assert copied.is_fifo(), "somebody reads it"


def test_a_worker_that_cannot_heed_one_signal_hears_the_next(database):
    heard: Heard = queue.SimpleQueue()

    def heed(signal: Signal) -> None:
        heard.put(signal)
        if signal is Signal.PARTICIPANT_PRESENT:
            raise OSError("Cannot allocate memory")  # a process that cannot be started just now

    listener = SignalListener(database, "one", heed)
    listener.start()
    for signal in (Signal.PARTICIPANT_PRESENT, Signal.JOB_QUEUED):
        with database.transaction() as s:
            signal_workers(s, signal)
        assert heard.get(timeout=PATIENCE_S) is signal
    listener.close()


def test_a_database_behind_a_link_is_heard_of(database, listen, tmp_path):
    link = tmp_path / "linked.sqlite"
    link.symlink_to(database.file)
    linked = Database(f"sqlite:///{link}")
    heard = listen(linked, "one")
    with linked.transaction() as s:
        signal_workers(s, Signal.JOB_QUEUED)
    assert heard.get(timeout=PATIENCE_S) is Signal.JOB_QUEUED
