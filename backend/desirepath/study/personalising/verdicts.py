"""What became of one alignment: whether its policy may be shown. What a session makes of it: `alignment_jobs.py`."""

from __future__ import annotations

from desirepath.store.models import Job


def verdict(job: Job, *, rated: bool = False) -> str | None:
    """What became of one alignment, None while it goes on. rated: its trajectories are rated one by one, arrived or
    not."""
    if job.state == "succeeded":
        result = job.result or {}
        if not result.get("passed"):
            personal = result.get("personal")
            gate = result.get("gate") or {}
            unsure = personal is not None and not personal["passed"] and gate.get("passed")
            return "not_surely_better" if unsure else "gate_not_passed"
        return "shown" if result.get("comparisons") or (rated and result.get("situations")) else "no_scenes"
    return "job_failed" if job.state in ("failed", "cancelled", "cancelling") else None
