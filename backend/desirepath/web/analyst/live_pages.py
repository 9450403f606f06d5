"""The workspace's interactive weights: a policy's weights moved by hand, nine or chapter 5's three, its way redrawn.

The controls, the stage and the rollouts are those of the participants' step (`kinds/live.py`, `live_rollouts.py`);
nothing that is done here is stored. Figures of the same policy are `explanation_pages.py`'s and `flow_pages.py`'s.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from fastapi import APIRouter, Depends, Request
from starlette.responses import JSONResponse, Response

from desirepath.grammar.words import View
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.artefacts import ArtefactStore
from desirepath.study.kinds.live import CONTROLS, CORNERS, OBJECTIVES, in_triangle, three_corners
from desirepath.web.analyst.chosen_policies import ADAPTABLE, NOT_DRAWN, Side, Undrawable, objectives_of
from desirepath.web.analyst.workspace import (
    LIVE,
    Asked,
    Made,
    check_weights,
    find_asked,
    find_drawn,
    moved_on,
    words_of,
    workspace_page,
)
from desirepath.web.core.auth import check_csrf
from desirepath.web.core.catalogues import Catalogue
from desirepath.web.core.contract import reply_of
from desirepath.web.core.dependencies import Db, Files, services_of
from desirepath.web.core.lab_frame import lab_language
from desirepath.web.participant.replies import LivePaths

if TYPE_CHECKING:
    from desirepath.learning.policies.adaptable import AdaptablePolicy
    from desirepath.learning.policies.conditioned import ConditionedPolicy
    from desirepath.simulation.scene import Scene
    from desirepath.store.models import Artefact
    from desirepath_stage.stage import Stage

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["analyst"])


@dataclass(frozen=True)
class LiveScene:
    """One scene with its goal and a robot, whose paths come from the page."""

    scene: Scene
    view: View
    beside: tuple[Trajectory, ...]

    def show(self, stage: Stage) -> None:
        stage.live(self.scene, self.view, trajectories=self.beside)


@router.get("/lab/live")
def live(request: Request, database: Db, files: Files) -> Response:
    """The stage, with the policy's controls beside it."""
    t = services_of(request).texts.get(lab_language(request))
    asked = shown = problem = corners = None
    start: dict[str, float] = {}
    try:
        corners = _corners(request, t)
        with database.session() as s:
            asked = find_asked(request, s, LIVE)
        if asked is not None:
            if (onward := moved_on(request, asked, LIVE)) is not None:
                return onward
            side, drawn = asked.sides[0], asked
            if side.artefact.kind == ADAPTABLE:  # its weights sum to 1: a triangle and nothing else
                corners = list(objectives_of(side.artefact.kind, side.artefact.setup))
            start = in_triangle(side.weights, corners) if corners else dict(side.weights)
            check_weights(files, asked)
            shown = Made(lambda: [_live_scene(files, side, drawn)])
    except NOT_DRAWN as wrong:
        problem = words_of(request, wrong)
    return workspace_page(
        request,
        database,
        LIVE,
        asked,
        problem=problem,
        shown=shown,
        corners=corners,
        payload={"controls": CONTROLS, "triangle": corners},
        start=start,
        lab_words=True,
        all_objectives=OBJECTIVES,
        three_objectives=objectives_of(ADAPTABLE),
    )


def _live_scene(files: ArtefactStore, side: Side, asked: Asked) -> LiveScene:
    conditioned = _read(files, side.artefact)
    scene = _scene(conditioned.setup, asked.scene_seed)
    return LiveScene(scene, asked.view, _beside(conditioned, scene))


@router.get("/lab/live/paths", response_model=LivePaths)
def paths(
    request: Request,
    database: Db,
    files: Files,
    x: float | None = None,
    y: float | None = None,
    yaw: float | None = None,
) -> Response:
    """The way that the policy takes at the weights of the address, from the scene's start or from that pose."""
    from desirepath.simulation.scene import SceneError
    from desirepath.study.personalising.live_rollouts import path_of, roll_out

    try:
        with database.session() as s:
            asked = find_drawn(request, s, LIVE)
        side = asked.sides[0]
        conditioned = _read(files, side.artefact)
        pose = (x, y, yaw) if x is not None and y is not None and yaw is not None else None
        scene = _scene(conditioned.setup, asked.scene_seed)
        found = path_of(roll_out(conditioned.weighed(side.weights), scene, pose))
    except SceneError:
        return JSONResponse({"error": {"code": "pose", "message": "no robot can go on from there"}}, 422)
    except NOT_DRAWN as wrong:
        return JSONResponse({"error": {"code": "weights", "message": words_of(request, wrong)}}, 422)
    return reply_of(LivePaths, {"place": 0, "paths": [{"track": found.track, "arrives": found.arrives}]})


def _corners(request: Request, t: Catalogue) -> list[str] | None:
    """The three that are weighed in a triangle, None: sliders for all. Raises Undrawable, naming them as the page."""
    named = [corner for corner in request.query_params.getlist("corner") if corner]
    if not named:
        return None
    try:
        return three_corners(named)
    except ValueError as wrong:
        words = {name: t(f"flow.objectives.{name}") for name in OBJECTIVES}
        pair = next((pair for pair in CONTROLS if len(pair) == 2 and set(pair) <= set(named)), None)
        if len(named) != CORNERS:
            raise Undrawable("corners_count", count=len(named)) from None
        if set(named) <= set(words) and len(set(named)) < CORNERS:
            twice = next(name for name in named if named.count(name) > 1)
            raise Undrawable("corners_twice", name=words[twice]) from None
        if set(named) <= set(words) and pair:
            raise Undrawable("corners_opposite", first=words[pair[0]], second=words[pair[1]]) from None
        raise Undrawable("corners", message=str(wrong)) from None


def _read(files: ArtefactStore, artefact: Artefact) -> ConditionedPolicy | AdaptablePolicy:
    return _parsed(artefact.kind, files.get(artefact.id))


@lru_cache(maxsize=4)
def _parsed(kind: str, content: bytes) -> ConditionedPolicy | AdaptablePolicy:
    from desirepath.learning.policies.adaptable import AdaptablePolicy
    from desirepath.learning.policies.conditioned import ConditionedPolicy

    return (AdaptablePolicy if kind == ADAPTABLE else ConditionedPolicy).from_bytes(content)


@lru_cache(maxsize=64)
def _scene(setup: str, seed: int) -> Any:
    from desirepath.simulation.scenes import draw_scene
    from desirepath.simulation.setups import get_setup

    return draw_scene(get_setup(setup), seed)


def _beside(conditioned: ConditionedPolicy | AdaptablePolicy, scene: Scene) -> tuple[Trajectory, ...]:
    """What the robot may do, so that the view from above is wide enough where there are no walls."""
    from desirepath.study.personalising.live_rollouts import roll_out

    if scene.room is not None:
        return ()
    alone = [{}, *({name: 1.0} for name in conditioned.objectives)]
    return tuple(roll_out(conditioned.weighed(weights), scene) for weights in alone)
