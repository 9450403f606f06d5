"""What became of one alignment: whether its policy may be shown. What a session makes of it: `alignment_jobs.py`."""

from __future__ import annotations

from desirepath.store.job_results import DemonstrationsResult, Learned
from desirepath.store.models import Job


def verdict(job: Job, *, rated: bool = False) -> str | None:
    """What became of one alignment, None while it goes on. rated: its trajectories are rated one by one, arrived or
    not."""
    if job.state == "succeeded":
        result = job.result_as(Learned)
        if result is None or not result.passed:
            unsure = result is not None and result.why == "not_surely_better"
            return "not_surely_better" if unsure else "gate_not_passed"
        to_rate = rated and isinstance(result, DemonstrationsResult) and result.situations
        return "shown" if result.comparisons or to_rate else "no_scenes"
    return "job_failed" if job.state in ("failed", "cancelled", "cancelling") else None
