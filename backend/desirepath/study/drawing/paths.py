"""What was drawn at a step of kind `demonstration`, as it is read: the newest stroke, what was kept, what is shown now.

Nothing changes here; how a stroke comes in and what becomes of it is `strokes.py`'s.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.grammar.words import View
from desirepath.store.models import Session, StrokeRow, TrajectoryRow
from desirepath.study.drawing import walks
from desirepath.study.drawing.walks import PathStep

if TYPE_CHECKING:
    from desirepath.simulation.scene import Scene


@dataclass(frozen=True)
class Showing:
    """A trajectory that has to be shown now. walking: the participant walks beside it."""

    trajectory: str
    view: View
    playback_id: str
    walking: bool


def scene_of(step: PathStep) -> Scene:
    """The scene that a step's path is drawn in, the person standing."""
    from desirepath.simulation.demonstration_scenes import demonstration_scene  # numba comes with it

    return demonstration_scene(step.environment, step.pair)


def latest_stroke(s: DatabaseSession, session_id: str, step_key: str) -> StrokeRow | None:
    """The newest stroke of a step."""
    mine = select(StrokeRow).where(StrokeRow.session_id == session_id, StrokeRow.step_key == step_key)
    return s.scalars(mine.order_by(StrokeRow.attempt.desc()).limit(1)).first()


def find_kept_strokes(s: DatabaseSession, session_id: str, step: PathStep) -> Sequence[StrokeRow]:
    """What the participant kept in the situation of that step, in order."""
    mine = select(StrokeRow).where(
        StrokeRow.session_id == session_id,
        StrokeRow.environment == step.environment,
        StrokeRow.pair == step.pair,
        StrokeRow.state == "kept",
    )
    return s.scalars(mine.order_by(StrokeRow.created_at)).all()


def playback_id(stroke: StrokeRow) -> str:
    """Names one showing of a stroke's trajectory; another one whenever it begins again."""
    return hashlib.sha256(f"{stroke.id}:{stroke.shown_since}".encode()).hexdigest()[:24]


def is_walked(step: PathStep, stroke: StrokeRow) -> bool:
    """Whether the participant still has to walk beside the stroke's trajectory."""
    return step.person == "walks" and stroke.walk is None


def has_met_person(stroke: StrokeRow | None) -> bool:
    """Whether the robot met the participant who walked beside the stroke's trajectory."""
    return stroke is not None and stroke.state == "refused" and (stroke.walk or {}).get("source") == "walked"


def showing(step: PathStep, stroke: StrokeRow | None) -> Showing | None:
    """What the stage drives now, None if nothing. Who walked themselves then watches from outside."""
    if stroke is None or stroke.shown_since is None or stroke.trajectory is None:
        return None
    walking = is_walked(step, stroke)
    view = walks.beside_view(step) if walking else "top_down" if step.person == "walks" else step.view
    return Showing(stroke.trajectory, view, playback_id(stroke), walking)


def state_of(s: DatabaseSession, session: Session, step: PathStep) -> dict[str, Any]:
    """What a page is told of a drawing: `phase` drawing, ready (drawn, waits to be driven), driving or watched."""
    stroke = latest_stroke(s, session.id, step.key)
    phase = "drawing"
    if stroke is not None and stroke.state in ("drawn", "watched"):
        phase = "driving" if stroke.shown_since is not None else "ready" if stroke.state == "drawn" else "watched"
    going = stroke is not None and phase != "drawing"
    trajectory = s.get(TrajectoryRow, stroke.trajectory) if going and stroke is not None and stroke.trajectory else None
    shown = showing(step, stroke)
    return {
        "phase": phase,
        "walking": shown is not None and shown.walking,
        "met": has_met_person(stroke),
        "stroke": stroke.id if going and stroke is not None else None,
        "duration_s": trajectory.duration_s if trajectory is not None else None,
        "playback_id": shown.playback_id if shown else None,
        "may_skip": step.optional,
        "attempts": stroke.attempt if stroke is not None else 0,
    }


def count_kept(s: DatabaseSession, session_id: str, step: PathStep) -> int:
    """How many paths were kept in the situation of that step."""
    counted = select(func.count(StrokeRow.id)).where(
        StrokeRow.session_id == session_id,
        StrokeRow.environment == step.environment,
        StrokeRow.pair == step.pair,
        StrokeRow.state == "kept",
    )
    return s.scalar(counted) or 0
