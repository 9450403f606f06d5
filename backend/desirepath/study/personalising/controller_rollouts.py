"""The rollouts of an evaluation: three controllers in the situations that were drawn in (ch. 2).

They were made by the training's job; how they are shown and rated is `kinds/evaluation.py`'s.
"""

from __future__ import annotations

from typing import NamedTuple

from sqlalchemy.orm import Session as DatabaseSession

from desirepath.simulation.demonstration_scenes import pair_seed
from desirepath.store.job_results import DemonstrationsResult
from desirepath.store.models import Artefact, Session
from desirepath.study.personalising.alignment_jobs import jobs_of

ARMS = {"own": "own", "dwa": "base", "social_cost": "social_cost"}  # controller -> its word in the job's result


class Rollout(NamedTuple):
    """One controller in one situation. made_by: the policy's id, or the controller's name."""

    trajectory: str
    made_by: str


def rollouts_for(
    s: DatabaseSession, session: Session, environment: str, controller: str, pair: int | None = None
) -> list[Rollout]:
    """The controller's rollouts in one situation, or in all of its environment; none where nothing was learned."""
    for job in jobs_of(s, session):
        snapshot = s.get(Artefact, job.params["snapshot"])
        result = job.result_as(DemonstrationsResult)
        if snapshot is None or snapshot.setup != environment or result is None or not result.passed:
            continue
        made_by = result.policy if controller == "own" else controller
        return [
            Rollout(situation.of(ARMS[controller]), made_by)
            for situation in result.situations
            if pair is None or situation.scene_seed == pair_seed(environment, pair)
        ]
    return []
