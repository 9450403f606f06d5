"""Work that survives: needs first, each task once, two processes, one run per folder."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from desirepath_experiments.reproduction.tasks import Task, TaskResult, Work, finish, results_of


def number(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    return TaskResult({"of": params["value"]}, {"value": np.array(params["value"])})


def total(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    return TaskResult({}, {"value": np.array(sum(int(need.arrays["value"]) for need in needs))})


def broken(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    raise ValueError("value: broken on purpose")


FUNCTIONS = {"number": number, "total": total, "broken": broken}


def ignore(task: Task, done: int, todo: int, left: float) -> None:
    pass


@pytest.fixture
def work(tmp_path: Path) -> Work:
    return Work(tmp_path / "work")


def test_needs_are_computed_first_and_each_task_once(work: Work) -> None:
    one, two = Task("number", {"value": 1}), Task("number", {"value": 2})
    sums = [Task("total", {"name": name}, (one, two)) for name in ("a", "b")]
    seen: list[str] = []
    with work.claimed():
        computed = finish(
            sums, FUNCTIONS, work, processes=1, on_task=lambda task, done, todo, left: seen.append(task.key)
        )
        assert finish(sums, FUNCTIONS, work, processes=1, on_task=ignore) == 0
    assert computed == 4
    assert seen == [one.key, two.key, sums[0].key, sums[1].key]
    stored = work.load(sums[1])
    assert stored.arrays["value"] == 3
    assert stored.meta["params"] == {"name": "b"}
    assert stored.meta["made"]["seconds"] >= 0


def test_results_are_of_what_was_asked_and_stay_only_where_a_folder_is_named(work: Work) -> None:
    one, two = Task("number", {"value": 1}), Task("number", {"value": 2})
    asked = [Task("total", {}, (one, two)), one]
    assert [int(result.arrays["value"]) for result in results_of(asked, FUNCTIONS)] == [3, 1]
    assert not work.folder.exists() or not list(work.folder.glob("*.npz"))
    assert [int(result.arrays["value"]) for result in results_of(asked, FUNCTIONS, work.folder)] == [3, 1]
    with work.claimed():
        assert finish(asked, FUNCTIONS, work, processes=1, on_task=ignore) == 0


def test_two_processes_give_the_same(work: Work, tmp_path: Path) -> None:
    tasks = [Task("total", {}, tuple(Task("number", {"value": k}) for k in range(3)))]
    with work.claimed():
        assert finish(tasks, FUNCTIONS, work, processes=2, on_task=ignore) == 4
    assert work.load(tasks[0]).arrays["value"] == 3


def test_a_task_that_fails_leaves_the_finished_ones(work: Work) -> None:
    good, bad = Task("number", {"value": 5}), Task("broken", {})
    with work.claimed(), pytest.raises(ValueError, match="on purpose"):
        finish([good, bad], FUNCTIONS, work, processes=1, on_task=ignore)
    assert work.has(good)
    assert not work.has(bad)


def test_the_estimate_of_time_is_no_part_of_the_name() -> None:
    assert Task("number", {"value": 1}, seconds=5).key == Task("number", {"value": 1}).key
    assert Task("number", {"value": 1}).key != Task("number", {"value": 2}).key


def test_only_one_run_works_in_a_folder(work: Work) -> None:
    with work.claimed(), pytest.raises(RuntimeError, match="another run"), work.claimed():
        pass


def test_no_process_means_nothing_to_do_it(work: Work) -> None:
    with pytest.raises(ValueError, match="processes = 0"):
        finish([], FUNCTIONS, work, processes=0, on_task=ignore)


KILLED = """
    import time
    from pathlib import Path
    from desirepath_experiments.reproduction.tasks import TaskResult, Task, Work, finish

    def quick(params, needs):
        return TaskResult({}, {})

    def endless(params, needs):
        Path(params["running"]).touch()
        time.sleep(600)

    if __name__ == "__main__":
        folder = Path(__file__).parent
        work = Work(folder / "work")
        with work.claimed():
            finish([Task("quick", {}, seconds=9), Task("endless", {"running": str(folder / "running")})],
                   {"quick": quick, "endless": endless}, work, processes=2, on_task=lambda *told: None)
"""


def test_after_kill_9_finished_tasks_are_there_the_workers_end_and_the_folder_is_free(tmp_path: Path) -> None:
    script = tmp_path / "killed.py"
    script.write_text(textwrap.dedent(KILLED))
    root = Path(__file__).resolve().parents[3]
    process = subprocess.Popen([sys.executable, script], env={**os.environ, "PYTHONPATH": str(root)})
    work = Work(tmp_path / "work")
    try:
        while not ((tmp_path / "running").exists() and work.has(Task("quick", {}))):
            assert process.poll() is None
            time.sleep(0.05)
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    with work.claimed():
        assert work.has(Task("quick", {}))
    while any(running(child) for child in children):  # pytest's timeout is the limit
        time.sleep(0.05)
    assert len(children) >= 2


def running(pid: str) -> bool:
    """Whether the process still runs; one that waits to be reaped does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
