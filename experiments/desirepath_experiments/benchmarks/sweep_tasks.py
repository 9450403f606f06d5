"""The tasks of `desirepath benchmark workers`: to wait, which costs no processor, or to work, which keeps one busy."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from desirepath_experiments.reproduction.tasks import Function, TaskResult


def waiting(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """Wait for `seconds`: what is measured is the queue, on however many cores."""
    time.sleep(float(params["seconds"]))
    return TaskResult({"number": params["number"]}, {})


def working(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """Keep one core busy for `seconds` of its time."""
    began, turns = time.process_time(), 0
    while time.process_time() - began < float(params["seconds"]):
        turns += 1
    return TaskResult({"number": params["number"]}, {})


def summed(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """The sum of the numbers of the tasks that it needs."""
    return TaskResult({"sum": sum(int(need.meta["number"]) for need in needs)}, {})


FUNCTIONS: dict[str, Function] = {"waiting": waiting, "working": working, "summed": summed}
