"""The learning curves of a job as lines to draw or to take away. What a job reports stands in `context.py`.

A training that evaluates each checkpoint twice, as it is and with averaged weights, has two lines in a figure.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from sqlalchemy import select
from sqlalchemy.orm import Session

from desirepath.store.models import Job, JobMetric

Points = list[tuple[int, float]]
RAW, AVERAGED = "raw", "averaged"
WHICH = "averaged"  # the metric that says of which weights those after it are: 1 averaged, 0 raw
UNTOLD = (WHICH, "rollouts")
STEPS = {"ensemble": "steps", "queries": "scenes", "train_base": "updates", "train_demonstrations": "updates"}


def curves_of(s: Session, job_id: str) -> dict[str, dict[str, Points]]:
    """Metric -> line -> points, in the order in which they were reported; a metric with one line has it under "".
    Curves of fewer than two steps are left out."""
    return split(s.scalars(select(JobMetric).where(JobMetric.job_id == job_id).order_by(JobMetric.id)))


def split(metrics: Iterable[JobMetric]) -> dict[str, dict[str, Points]]:
    """As `curves_of`, of metrics in the order in which they were reported."""
    curves: dict[str, dict[str, Points]] = {}
    line, at = "", None
    for metric in metrics:
        if metric.name == WHICH:
            line, at = (AVERAGED if metric.value else RAW), metric.step
        if metric.step != at:
            line = ""
        if metric.name not in UNTOLD:
            curves.setdefault(metric.name, {}).setdefault(line, []).append((metric.step, metric.value))
    return {name: drawn for name, lines in curves.items() if (drawn := _drawable(lines))}


def _drawable(lines: Mapping[str, Points]) -> dict[str, Points]:
    """One line where both say the same (how far a training is does not depend on the weights)."""
    if "" in lines or lines.get(RAW) == lines.get(AVERAGED):
        together = sorted({point for points in lines.values() for point in points})
        lines = {"": together}
    return dict(lines) if any(len({step for step, _ in points}) > 1 for points in lines.values()) else {}


def step_of(job: Job) -> str:
    """What a job's curves are drawn over: a key below `curves.steps`."""
    if job.params.get("recipe") == "conditioning_search":
        return "tried"
    return STEPS.get(job.kind, "updates" if job.kind == "align" else "step")
