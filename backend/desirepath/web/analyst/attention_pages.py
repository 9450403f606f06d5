"""The workspace's attention: what a policy with attention looks at among pedestrians, over time, on the stage.

Sectors of the lidar are blue, rays of the descriptors red (chapter 4); drawing them is the stage's
(`client/attention.js`).
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from fastapi import APIRouter, Depends, Request
from starlette.responses import Response

from desirepath.explain.shown_explanation import ShownAttention, ShownExplanation
from desirepath.store.artefacts import ArtefactStore
from desirepath.web.analyst.chosen_policies import NOT_DRAWN
from desirepath.web.analyst.workspace import (
    ATTENTION,
    Asked,
    Made,
    find_asked,
    find_drawn,
    moved_on,
    part,
    words_of,
    workspace_page,
)
from desirepath.web.core.auth import check_csrf
from desirepath.web.core.dependencies import Db, Files
from desirepath.web.stage.replay_stages import Replay

if TYPE_CHECKING:  # the simulator comes with it; a server that starts need not wait for it
    from desirepath.simulation.trajectory import Trajectory

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["analyst"])


@router.get("/lab/attention")
def attention(request: Request, database: Db, files: Files, building: str = "", plain: bool = False) -> Response:
    """The rollout in that scene with what the policy attends to. plain: without."""
    from desirepath.simulation.crowds.crowd_setups import TRAINED_SETUPS

    asked = shown = problem = None
    try:
        with database.session() as s:
            asked = find_asked(request, s, ATTENTION)
        if asked is not None:
            if (onward := moved_on(request, asked, ATTENTION)) is not None:
                return onward
            drawn = asked
            shown = Made(lambda: [_replay(files, drawn, _where(building), plain=plain)])
    except NOT_DRAWN as wrong:
        problem = words_of(request, wrong)
    return workspace_page(
        request,
        database,
        ATTENTION,
        asked,
        problem=problem,
        shown=shown,
        buildings=TRAINED_SETUPS,
        building=_where(building),
        plain=plain,
    )


@router.get("/lab/attention/outcome")
def outcome(request: Request, database: Db, files: Files, building: str = "") -> Response:
    """How the rollout ends, in a sentence."""
    found = problem = None
    try:
        with database.session() as s:
            asked = find_drawn(request, s, ATTENTION)
        trajectory, _ = roll_out(files.get(asked.sides[0].artefact.id), _where(building), asked.scene_seed)
        found = trajectory.outcome.name.lower()
    except NOT_DRAWN as wrong:
        problem = words_of(request, wrong)
    return part(request, "analyst/attention_outcome.html", problem=problem, outcome=found)


def _where(building: str) -> str:
    """The setup whose scenes are drawn."""
    from desirepath.simulation.crowds.crowd_setups import TRAINED_SETUPS

    return building if building in TRAINED_SETUPS else TRAINED_SETUPS[0]


def _replay(files: ArtefactStore, asked: Asked, building: str, *, plain: bool) -> Replay:
    trajectory, attended = roll_out(files.get(asked.sides[0].artefact.id), building, asked.scene_seed)
    explained = None if plain else explanation_of(trajectory, attended)
    return Replay((trajectory,), (asked.sides[0].artefact.name,), explained=explained, view=asked.view)


@lru_cache(maxsize=16)
def roll_out(content: bytes, setup: str, seed: int) -> tuple[Trajectory, ShownAttention]:
    """The policy in that scene among two who walk, with what it attended to."""
    from desirepath.learning.pedestrians.attended import as_trajectory, measure_attention
    from desirepath.learning.policies.attention import AttentionPolicy
    from desirepath.simulation.crowds.crowd_scenes import PUBLISHED, draw_crowd_scene

    policy = AttentionPolicy.from_bytes(content)
    found = policy.rolled_out(draw_crowd_scene(setup, seed, PUBLISHED))
    return as_trajectory(found), ShownAttention(*measure_attention(policy.actor(), found))


def explanation_of(trajectory: Trajectory, attention: ShownAttention) -> ShownExplanation:
    """Nothing but the attention."""
    nothing: tuple[tuple[float, ...], ...] = ((),) * len(trajectory.poses)
    return ShownExplanation((), nothing, outlines=False, lidar=False, attention=attention)
