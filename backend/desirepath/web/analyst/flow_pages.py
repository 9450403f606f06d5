"""The analysts' flow-field page: where one policy heads from everywhere in a scene, or two with their difference.

The figure is drawn by `figure_process.py`; the same scene in 3D goes through `replay_stages.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import TYPE_CHECKING

from fastapi import APIRouter, Depends, Request
from starlette.responses import Response

from desirepath.explain.flow_words import Words
from desirepath.web.analyst.chosen_policies import (
    NOT_DRAWN,
    SIDES,
    Asked,
    find_asked,
    form_of,
    no_file,
    problem_of,
    query_of,
)
from desirepath.web.core.auth import check_csrf
from desirepath.web.core.catalogues import Catalogue
from desirepath.web.core.dependencies import Db, Files, services_of
from desirepath.web.core.figure_process import FlowOrder
from desirepath.web.core.lab_frame import LabRefusal, lab_language, lab_page
from desirepath.web.core.media import FIGURE_ENDINGS, answers_with, figure_file
from desirepath.web.stage.replay_stages import Replay

if TYPE_CHECKING:  # the simulator comes with these; a server that starts need not wait for it
    from desirepath.explain.flow_files import FigureFiles
    from desirepath.learning.policies.policy import DrivingPolicy

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["analyst"])

SHOWN = ("png",)


@router.get("/lab/flow-field")
def flow_field(request: Request, database: Db, files: Files, stage: bool = False) -> Response:
    """The form, and below it the figure, its numbers and the same scene in 3D."""
    from desirepath.simulation.scenes import LARGEST_SEED

    t = services_of(request).texts.get(lab_language(request))
    asked = figure = token = problem = None
    try:
        with database.session() as s:
            asked = find_asked(request, s)
        if asked is not None:
            policies = [side.policy(files) for side in asked.sides]
            figure = _drawn(request, t, asked, policies)[1]
            if stage:
                token = services_of(request).replays.grant(_replay(asked, policies))
    except NOT_DRAWN as wrong:
        problem = problem_of(t, wrong)
    seed = asked.scene_seed if asked is not None else None
    return lab_page(
        request,
        "analyst/flow_field.html",
        status=422 if problem else 200,
        **form_of(request, database),
        problem=problem,
        asked=asked,
        figure=figure,
        command=_command(asked) if asked else None,
        another=query_of(request.query_params, scene=str(seed + 1))
        if seed is not None and seed < LARGEST_SEED
        else None,
        replay=token,
    )


@router.get("/lab/flow-field/{name}", response_class=Response, responses=answers_with(*FIGURE_ENDINGS))
def flow_file(request: Request, name: str, database: Db, files: Files) -> Response:
    """One file of the figure that the rest of the address asks for."""
    t = services_of(request).texts.get(lab_language(request))
    try:
        with database.session() as s:
            asked = find_asked(request, s)
        if asked is None:
            raise LabRefusal(404, "no_figure")
        mark, figure = _drawn(request, t, asked, [side.policy(files) for side in asked.sides])
    except NOT_DRAWN as wrong:
        return no_file(wrong)
    if name not in figure.files:
        raise LabRefusal(404, "no_figure")
    return figure_file(request, name, figure.files[name], shown=SHOWN, mark=mark)


def _drawn(request: Request, t: Catalogue, asked: Asked, policies: Sequence[DrivingPolicy]) -> tuple[str, FigureFiles]:
    from desirepath.explain.flow_field import CELL_M

    order = FlowOrder(
        tuple((side.name, one.without_critic().to_bytes()) for side, one in zip(asked.sides, policies, strict=True)),
        asked.scene_seed,
        CELL_M,
        tuple((field.name, t.table("flow.words")[field.name]) for field in fields(Words)),
    )
    return services_of(request).figures.draw(order)


def _replay(asked: Asked, policies: Sequence[DrivingPolicy]) -> Replay:
    from desirepath.simulation.fast import rollout
    from desirepath.simulation.scenes import draw_scene
    from desirepath.simulation.setups import get_setup

    setup = get_setup(policies[0].setup)
    scene = draw_scene(setup, asked.scene_seed)
    rollouts = tuple(rollout(setup, policy.rollout_policy, [scene])[0] for policy in policies)
    names = [f"{x.upper()}: {side.name}" for x, side in zip(SIDES, asked.sides, strict=False)]
    return Replay(rollouts, tuple(names) if len(names) > 1 else (asked.sides[0].name,))


def _command(asked: Asked) -> str:
    named = " ".join(side.reference for side in asked.sides)
    return f"desirepath policies flow-field {named} --scene {asked.scene_seed} --out flow_field"
