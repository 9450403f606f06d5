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
from desirepath.store.query_sets import register_made


def make_setup_ready(context: JobContext, params: TrainSetupParams) -> dict[str, Any]:
    """Policies and query sets of the setup, into its folder and, as each stage ends, into the store."""
    config = SetupTrainingConfig(params.seed, params.queries, params.effort)
    began: dict[str, float] = {}

    def told(stage: str, fraction: float, metrics: dict[str, float], left_s: float) -> None:
        began.setdefault("left_s", max(left_s, 1.0))
        whole = max(0.0, 1 - left_s / max(began["left_s"], left_s))
        still = " It stood still and was begun anew." if "begun_anew" in metrics else ""
        context.progress(whole, message=f"{stage.replace('_', ' ')} {fraction:.0%}; {in_words(left_s)} left.{still}")

    kept: dict[str, str] = {}

    def keep(names: list[str]) -> None:
        """List what a stage made at once: who stops the job then keeps it."""
        with context.database.transaction() as s:
            require_job(s, context)
            kept.update({name: register_made(s, context.files, name, job_id=context.job.id).id for name in names})
        tell_changed()

    made = train_setup(params.setup, config, told, keep)
    return {
        "success_rate": made.success_rate,
        "begun_anew": made.begun_anew,
        "seconds": made.seconds,
        "policies": [kept[name] for name in made.policies],
        "query_sets": [kept[name] for name in made.query_sets],
    }
