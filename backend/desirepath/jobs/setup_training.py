"""The job that makes everything that studies need in a lab's own setup, and lists it as artefacts.

What is made, and how it goes on where it was stopped: `learning/shipping/own_setup.py`.
"""

from __future__ import annotations

from typing import Any

from desirepath.jobs.context import JobContext
from desirepath.jobs.kept_artefacts import require_job
from desirepath.jobs.kinds import TrainSetupParams
from desirepath.learning.shipping.own_setup import SetupTrainingConfig, in_words, train_setup
from desirepath.simulation.setups import tell_changed
from desirepath.store.query_sets import import_query_set
from desirepath.store.shipped_policies import register


def make_setup_ready(context: JobContext, params: TrainSetupParams) -> dict[str, Any]:
    """Policies and query sets of the setup, into its folder and into the store."""
    config = SetupTrainingConfig(params.seed, params.queries, params.effort)
    began: dict[str, float] = {}

    def told(stage: str, fraction: float, metrics: dict[str, float], left_s: float) -> None:
        began.setdefault("left_s", max(left_s, 1.0))
        whole = max(0.0, 1 - left_s / max(began["left_s"], left_s))
        still = " It stood still and was begun anew." if "begun_anew" in metrics else ""
        context.progress(whole, message=f"{stage.replace('_', ' ')} {fraction:.0%}; {in_words(left_s)} left.{still}")

    made = train_setup(params.setup, config, told)
    with context.database.transaction() as s:
        require_job(s, context)
        policies = [register(s, context.files, name, job_id=context.job.id).id for name in made.policies]
        queries = [import_query_set(s, context.files, name).id for name in made.query_sets]
    tell_changed()
    return {
        "success_rate": made.success_rate,
        "begun_anew": made.begun_anew,
        "seconds": made.seconds,
        "policies": policies,
        "query_sets": queries,
    }
