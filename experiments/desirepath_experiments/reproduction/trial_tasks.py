"""Tasks that stand for a chapter's where only the queue is of interest: they wait, and add up who has waited."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from desirepath_experiments.reproduction.tasks import Function, TaskResult


def waiting(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """Wait for `seconds`, which costs no processor."""
    time.sleep(float(params["seconds"]))
    return TaskResult({"number": params["number"]}, {})


def summed(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """The sum of the numbers of the tasks that it needs."""
    return TaskResult({"sum": sum(int(need.meta["number"]) for need in needs)}, {})


FUNCTIONS: dict[str, Function] = {"waiting": waiting, "summed": summed}
