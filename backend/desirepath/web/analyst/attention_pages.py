"""The analysts' page of what a policy with attention looks at among pedestrians, over time, on the stage.

Sectors of the lidar are blue, rays of the descriptors red (chapter 4); drawing them is the stage's
(`client/attention.js`).
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from fastapi import APIRouter, Depends, Request
from sqlalchemy import select
from starlette.responses import Response

from desirepath.explain.shown_explanation import ShownAttention, ShownExplanation
from desirepath.grammar.words import View
from desirepath.store.artefact_upkeep import is_offered
from desirepath.store.models import Artefact
from desirepath.store.shipped_policies import find_artefact
from desirepath.web.analyst.chosen_policies import Undrawable, first_scene, problem_of
from desirepath.web.core.auth import check_csrf
from desirepath.web.core.dependencies import Db, Files, services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_language, lab_page, rights_in
from desirepath.web.core.permits import may_with, seen_artefacts
from desirepath.web.core.roles import Right
from desirepath.web.stage.replay_stages import Replay
from desirepath_stage.views import VIEWS

if TYPE_CHECKING:  # the simulator comes with it; a server that starts need not wait for it
    from desirepath.simulation.trajectory import Trajectory

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["analyst"])
KIND = "attention_policy"


@router.get("/lab/attention")
def attention(
    request: Request,
    database: Db,
    files: Files,
    policy: str = "",
    building: str = "",
    scene: str = "",
    view: str = "",
    plain: bool = False,
) -> Response:
    """The form, and below it the rollout in that scene with what the policy attends to. plain: without."""
    from desirepath.simulation.crowds.crowd_setups import TRAINED_SETUPS
    from desirepath.simulation.scenes import LARGEST_SEED

    services = services_of(request)
    with database.session() as s:
        rights = rights_in(request)
        rows = select(Artefact).where(Artefact.kind == KIND, is_offered(), seen_artefacts(rights))
        choices = list(s.scalars(rows.order_by(Artefact.created_at.desc())))
        chosen = find_artefact(s, policy) if policy else None
        if policy and (chosen is None or chosen.kind != KIND or not may_with(s, rights, Right.LOOK, chosen)):
            raise LabRefusal(404, "no_artefact")
    if chosen is not None and chosen.quarantined_at is not None:
        raise LabRefusal(410, "quarantined")
    seed, problem, token, outcome = scene or str(first_scene()), None, None, None
    where = building if building in TRAINED_SETUPS else TRAINED_SETUPS[0]
    seen: View = next((name for name in VIEWS if name == view), VIEWS[0])
    if not seed.isdecimal() or not seed.isascii() or len(seed) > 16 or int(seed) > LARGEST_SEED:
        wrong = Undrawable("scene", value=seed, largest=str(LARGEST_SEED))
        problem = problem_of(services.texts.get(lab_language(request)), wrong)
    elif chosen is not None:
        trajectory, shown = roll_out(files.get(chosen.id), where, int(seed))
        explained = None if plain else explanation_of(trajectory, shown)
        token = services.replays.grant(Replay((trajectory,), (chosen.name,), explained=explained, view=seen))
        outcome = trajectory.outcome.name.lower()
    return lab_page(
        request,
        "analyst/attention.html",
        status=422 if problem else 200,
        choices=choices,
        chosen=chosen,
        buildings=TRAINED_SETUPS,
        building=where,
        scene=seed,
        view=seen,
        views=VIEWS,
        plain=plain,
        problem=problem,
        replay=token,
        outcome=outcome,
        another=str(int(seed) + 1) if problem is None and int(seed) < LARGEST_SEED else None,
    )


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
