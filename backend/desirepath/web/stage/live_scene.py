"""What a stage shows where weights are changed by hand: the scene of one of the step's places, with its goal.

The paths come from the page itself (`participant/live_requests.py`); `presenting.py` asks here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from desirepath.store.database import Database
from desirepath.store.models import Session
from desirepath.study.kind import kind_of
from desirepath.study.kinds.live import LiveKind, LiveStep
from desirepath.study.session import machine

if TYPE_CHECKING:
    from desirepath_stage.stage import Stage


def present(database: Database, stage: Stage, session_id: str, place: int = 0) -> None:
    """Show that place, unless the session went on meanwhile."""
    from desirepath.study.personalising.live_rollouts import scenes_of, typical_rollouts, warm_up

    with database.session() as s:
        session = s.get_one(Session, session_id)
        step = machine.step_of(session)
        light = session.device.get("scene_detail") == "light"
    kind = kind_of(step)
    if not isinstance(step, LiveStep) or not isinstance(kind, LiveKind) or place >= step.scenes:
        return
    scene = scenes_of(step.setup)[place]
    beside = typical_rollouts(step.setup, place) if scene.room is None else ()
    stage.detail = "light" if light else "full"
    stage.live(scene, step.view, trajectories=beside, robots=kind.robots_in(step))
    warm_up(step.setup)  # while the browser builds the room, so that the first path is not waited for
