"""What a stage shows at a drawing: the paper with what was kept there, or the rollout of the path that was drawn.

The routes that change a drawing live in `participant/stroke_requests.py`; `presenting.py` asks here when a stage
has connected.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.artefacts import ArtefactStore, load_trajectory
from desirepath.store.database import Database
from desirepath.store.models import Session, StrokeRow
from desirepath.study.drawing import paths, walks
from desirepath.study.drawing.strokes import MOST_POINTS
from desirepath.study.kinds.demonstration import DemonstrationStep, drawing_of
from desirepath.study.session import machine
from desirepath_stage.paper import Paper

if TYPE_CHECKING:
    from desirepath_stage.stage import Stage

SPECK_M = 0.03  # kept paths are shown in steps of this; finer is not to be seen


def play_stroke(database: Database, files: ArtefactStore, stage: Stage, session_id: str, shown: paths.Showing) -> None:
    """Show a stroke's rollout, unless the session went on meanwhile."""
    with database.session() as s:
        step = machine.step_of(s.get_one(Session, session_id))
        latest = paths.latest_stroke(s, session_id, step.key)
    if not isinstance(step, DemonstrationStep) or paths.showing(step, latest) != shown:
        return
    # Rolled out in the scene that was drawn in: the demonstration's own goal has moved to the path's end.
    scene = walks.scene_with(paths.scene_of(step), latest.walk if latest is not None else None)
    rollout = replace(load_trajectory(files, shown.trajectory), scene=scene)
    drawn = Paper(step.key, drawn=latest.drawn, resting=True) if latest is not None else None
    stage.play(
        rollout, label="", view=shown.view, playback_id=shown.playback_id, goal=True, walking=shown.walking, paper=drawn
    )


def as_drawn(s: DatabaseSession, session_id: str, step: DemonstrationStep, stroke: StrokeRow) -> Paper:
    """The paper as it lay there when that stroke had been drawn: with it, and with what was kept there before."""
    before = [kept for kept in paths.find_kept_strokes(s, session_id, step) if kept.created_at < stroke.created_at]
    offered = walks.offer_walks(step)
    return Paper(
        step.key,
        [_thinned(kept) for kept in before],
        stroke.drawn,
        resting=True,
        walks=[walks.scene_with(paths.scene_of(step), walk) for walk in offered],
        chosen=offered.index(stroke.walk) if stroke.walk in offered else None,
    )


def present(database: Database, stage: Stage, session_id: str) -> None:
    """Bring a stage to the drawing that its session stands at: the scene, what was kept there, what is drawn."""
    with database.session() as s:
        session = s.get_one(Session, session_id)
        step = drawing_of(session)
        kept = [_thinned(stroke) for stroke in paths.find_kept_strokes(s, session_id, step)]
        latest = paths.latest_stroke(s, session_id, step.key)
        phase = paths.state_of(s, session, step)["phase"]
    on_it = latest is not None and latest.state in ("drawn", "watched", "refused")
    scene = paths.scene_of(step)
    offered = walks.offer_walks(step)
    paper = Paper(
        step.key,
        kept,
        latest.drawn if on_it and latest is not None else None,
        resting=phase != "drawing",
        problem=latest.problem if on_it and latest is not None else None,
        walks=[walks.scene_with(scene, walk) for walk in offered],
        most_points=MOST_POINTS,
        chosen=offered.index(latest.walk) if on_it and latest is not None and latest.walk in offered else None,
    )
    stage.draw(scene, step.view, paper)


def _thinned(stroke: StrokeRow) -> list[tuple[float, float]]:
    points: list[tuple[float, float]] = []
    for x, y in stroke.drawn["points"]:
        if not points or (x - points[-1][0]) ** 2 + (y - points[-1][1]) ** 2 >= SPECK_M**2:
            points.append((x, y))
    return points
