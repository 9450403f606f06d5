"""The drives of an evaluation: three controllers in the situations that were drawn in (spec 02). One drive per trial.

The drives were made by the training's job; which one is whose stands in the trial's block and arms, never on a page.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy.orm import Session as DatabaseSession

from backend.store.models import Artefact, Session, Trial
from backend.study.personalising import training

Step = dict[str, Any]
DRIVES = {"own": "own", "dwa": "base", "social_cost": "social_cost"}  # controller -> its word in the job's result


def can_be_shown(s: DatabaseSession, session: Session, step: Step) -> bool:
    """Whether there is a drive for the step, or for questions about a controller, any of its drives."""
    return bool(_drives(s, session, step))


def make_trial(s: DatabaseSession, session: Session, step: Step, now: datetime) -> Trial:
    """The trial of an evaluation step; both its trajectories are the one drive that is shown."""
    (drive,) = _drives(s, session, step)
    trial = Trial(
        session_id=session.id,
        step_key=step["key"],
        index=session.position,
        block=step["block"],
        kind="evaluation",
        view=step["view"],
        trajectory_a=drive["trajectory"],
        trajectory_b=drive["trajectory"],
        arms={"a": drive["made_by"], "b": drive["made_by"], "own": "a" if step["block"] == "own" else None},
        phase_since=now,
    )
    s.add(trial)
    s.flush()
    return trial


def _drives(s: DatabaseSession, session: Session, step: Step) -> list[dict[str, str]]:
    """The controller's drives in the step's situation, or in all of its environment; none where nothing was learned."""
    controller = step["block"]
    for job in training.jobs_of(s, session):
        snapshot = s.get(Artefact, job.params["snapshot"])
        result = job.result or {}
        if snapshot is None or snapshot.setup != step["environment"] or not result.get("passed"):
            continue
        made_by = result["policy"] if controller == "own" else controller
        return [
            {"trajectory": drives[DRIVES[controller]], "made_by": made_by}
            for drives in result.get("situations", result["comparisons"])  # jobs of older versions told these alone
            if drives["scene_seed"] == step.get("pair", drives["scene_seed"])
        ]
    return []
