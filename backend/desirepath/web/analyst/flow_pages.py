"""The workspace's flow field: where one policy heads from everywhere in a scene, or two with their difference.

On the stage rollouts from many starts; below it the figure, drawn by `figure_process.py`, which the page fetches.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from functools import lru_cache
from typing import TYPE_CHECKING

from fastapi import APIRouter, Depends, Request
from starlette.responses import Response

from desirepath.explain.flow_words import Words
from desirepath.store.artefacts import ArtefactStore
from desirepath.web.analyst.chosen_policies import NOT_DRAWN, SIDES, no_file
from desirepath.web.analyst.workspace import (
    FLOW,
    Asked,
    Made,
    check_weights,
    find_asked,
    find_drawn,
    moved_on,
    part,
    roll_out_sides,
    words_of,
    workspace_page,
)
from desirepath.web.core.auth import check_csrf
from desirepath.web.core.catalogues import Catalogue
from desirepath.web.core.dependencies import Db, Files, services_of
from desirepath.web.core.figure_process import FlowOrder
from desirepath.web.core.lab_frame import LabRefusal, lab_language
from desirepath.web.core.media import FIGURE_ENDINGS, answers_with, figure_file
from desirepath.web.stage.replay_stages import Replay
from desirepath_stage.paper import Beside

if TYPE_CHECKING:  # the simulator comes with these; a server that starts need not wait for it
    from desirepath.explain.flow_files import FigureFiles
    from desirepath.simulation.trajectory import Floats

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["analyst"])

SHOWN = ("png",)
STARTS = 28  # ours: so many paths on the floor still tell where a policy heads, and are rolled out in no time
PALE = ((150, 172, 208), (214, 164, 126))  # of the two robots' colours, under their own paths


@router.get("/lab/flow-field")
def flow_field(request: Request, database: Db, files: Files) -> Response:
    """The stage with rollouts from many starts; the figure is fetched."""
    t = services_of(request).texts.get(lab_language(request))
    asked = shown = problem = None
    try:
        with database.session() as s:
            asked = find_asked(request, s, FLOW)
        if asked is not None:
            if (onward := moved_on(request, asked, FLOW)) is not None:
                return onward
            drawn = asked
            check_weights(files, asked)
            shown = Made(lambda: [_replay(files, t, drawn)])
    except NOT_DRAWN as wrong:
        problem = words_of(request, wrong)
    return workspace_page(request, database, FLOW, asked, problem=problem, shown=shown, starts=STARTS)


@router.get("/lab/flow-field/figure")
def flow_figure(request: Request, database: Db, files: Files) -> Response:
    """The figure, and its numbers."""
    t = services_of(request).texts.get(lab_language(request))
    asked = figure = problem = None
    try:
        with database.session() as s:
            asked = find_drawn(request, s, FLOW)
        figure = _drawn(request, t, asked, files)[1]
    except NOT_DRAWN as wrong:
        problem = words_of(request, wrong)
    command = _command(asked) if asked is not None else None
    return part(request, "analyst/flow_figure.html", problem=problem, asked=asked, figure=figure, command=command)


@router.get("/lab/flow-field/{name}", response_class=Response, responses=answers_with(*FIGURE_ENDINGS))
def flow_file(request: Request, name: str, database: Db, files: Files) -> Response:
    """One file of the figure that the rest of the address asks for."""
    t = services_of(request).texts.get(lab_language(request))
    try:
        with database.session() as s:
            asked = find_drawn(request, s, FLOW)
        mark, figure = _drawn(request, t, asked, files)
    except NOT_DRAWN as wrong:
        return no_file(wrong)
    if name not in figure.files:
        raise LabRefusal(404, "no_figure")
    return figure_file(request, name, figure.files[name], shown=SHOWN, mark=mark)


def _drawn(request: Request, t: Catalogue, asked: Asked, files: ArtefactStore) -> tuple[str, FigureFiles]:
    from desirepath.explain.flow_field import CELL_M

    order = FlowOrder(
        tuple((side.name, side.policy(files).without_critic().to_bytes()) for side in asked.sides),
        asked.scene_seed,
        CELL_M,
        tuple((field.name, t.table("flow.words")[field.name]) for field in fields(Words)),
    )
    return services_of(request).figures.draw(order)


def _replay(files: ArtefactStore, t: Catalogue, asked: Asked) -> Replay:
    rollouts, names = roll_out_sides(files, asked)
    return Replay(rollouts, names, tuple(_beside(files, t, asked)), view=asked.view)


def _beside(files: ArtefactStore, t: Catalogue, asked: Asked) -> Iterator[Beside]:
    for side, letter, colour in zip(asked.sides, SIDES, PALE, strict=False):
        if side.artefact.kind == "depth_controller":  # its pictures take a second each
            continue
        paths = _from_elsewhere(files, side.artefact.id, side.weights_in_words, asked.scene_seed)
        named = f"{letter.upper()}: " if len(asked.sides) > 1 else ""
        yield Beside(f"{named}{t('flow.from_elsewhere', count=len(paths))}", colour, paths)


@lru_cache(maxsize=32)
def _from_elsewhere(files: ArtefactStore, policy: str, weights: str, seed: int) -> tuple[Floats, ...]:
    """Where it drives from starts all over the scene, (n, 3) each."""
    from desirepath.explain.flow_field import rollouts_from, spread_starts
    from desirepath.learning.policies.shipped import policy_conditioned_on
    from desirepath.simulation.scenes import draw_scene
    from desirepath.simulation.setups import get_setup

    acting = policy_conditioned_on(files.get(policy), f"{policy}@{weights}" if weights else policy)
    scene = draw_scene(acting.setup, seed)
    starts, drives = spread_starts(scene, STARTS + 1)[1:], acting.in_scene(scene).rollout_policy
    found = rollouts_from({"": drives}, get_setup(acting.setup), starts)[""] if starts else []
    return tuple(one.poses for one in found)


def _command(asked: Asked) -> str:
    named = " ".join(side.reference for side in asked.sides)
    return f"desirepath policies flow-field {named} --scene {asked.scene_seed} --out flow_field"
