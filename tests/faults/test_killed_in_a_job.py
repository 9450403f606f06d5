"""kill -9 of the server, and then of the worker, in the middle of one job: it goes on under the same id."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

from sqlalchemy import select

from desirepath.jobs.process import read_log
from desirepath.store.models import Artefact, Job
from desirepath.store.outbox import enqueue_job
from tests.faults.installation import Installation

PATIENCE_S = 120


def descendants(pid: int) -> dict[int, str]:
    """The living processes below a process, with their commands (Linux)."""
    parents: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                status = (entry / "status").read_text()
            except OSError:
                continue  # gone while we looked
            parent = int(status.partition("PPid:")[2].split()[0])
            parents.setdefault(parent, []).append(int(entry.name))
    found: dict[int, str] = {}
    below = parents.get(pid, [])
    while below:
        one = below.pop()
        found[one] = command_of(one)
        below += parents.get(one, [])
    return found


def command_of(pid: int) -> str:
    """The command line of a process, empty when it is gone or only waits to be buried."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    except OSError:
        return ""


def wait_until(holds: Callable[[], object], told: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline, told()
        time.sleep(0.1)


def test_a_job_survives_the_death_of_its_server_and_of_its_worker(tmp_path: Path) -> None:
    installation = Installation(tmp_path)
    with installation.database.transaction() as s:
        job_id = enqueue_job(s, "evaluate", {"policy": "study_room/base", "scenes": 200}, created_by="tests").id

    def log() -> str:
        return read_log(installation.settings, job_id, 10**6)

    def begun(times: int) -> None:
        wait_until(lambda: log().count(" begins\n") >= times, log)

    def job() -> Job:
        with installation.database.session() as s:
            return s.get_one(Job, job_id)

    with installation.serving(worker=True) as (_, server):
        begun(1)
        family = descendants(server.pid)
        assert any("desirepath.jobs.run" in command for command in family.values()), family
        server.kill()
        server.wait()
        wait_until(lambda: not any(map(command_of, family)), lambda: "the worker or its training outlived the server")
        assert job().state == "running", "nobody was there to say otherwise"
    with installation.serving(worker=True) as (_, server):
        begun(2)
        worker = next(pid for pid, command in descendants(server.pid).items() if " worker" in command)
        os.kill(worker, signal.SIGKILL)
        wait_until(lambda: job().state not in ("queued", "running"), log)
    assert job().state == "succeeded", job().error
    with installation.database.session() as s:
        made = list(s.scalars(select(Artefact.kind).where(Artefact.job_id == job_id)))
    assert made == ["evaluation"], "attempts that were cut short leave nothing behind"
