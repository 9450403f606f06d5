"""The analysts' flow-field page: where one policy heads from everywhere in a scene, or two with their difference.

The figure is drawn by `figure_process.py`; the same scene in 3D goes through `replay_stages.py`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Request
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import Response

from backend.api.core.auth import checked_csrf
from backend.api.core.catalogues import Catalogue
from backend.api.core.dependencies import Db, Files, services_of
from backend.api.core.figure_process import FigureError, FlowOrder
from backend.api.core.lab_frame import LabRefusal, lab_language, lab_page, rights_in
from backend.api.core.media import MEDIA, answers_with
from backend.api.core.permits import may_with, seen_artefacts
from backend.api.core.roles import Right, Rights
from backend.api.stage.replay_stages import Replay
from backend.explain.flow_words import Words
from backend.learning.errors import LearningError
from backend.store.artefact_upkeep import offered
from backend.store.artefacts import ArtefactStore
from backend.store.models import Artefact

if TYPE_CHECKING:  # the simulator comes with these; a server that starts need not wait for it
    from backend.explain.flow_files import FigureFiles
    from backend.learning.policies.policy import Policy

router = APIRouter(dependencies=[Depends(checked_csrf)], tags=["analyst"])

SIDES = ("a", "b")
CONDITIONED = "conditioned_policy"
KINDS = ("policy", CONDITIONED)
ENDINGS = ("png", "svg", "csv")
# Inline styles are how matplotlib colours an SVG; nothing else may happen in a figure that is opened by itself.
FIGURE_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


@dataclass(frozen=True)
class Side:
    """One policy of the figure: what was chosen and, for a conditioned one, what it is told."""

    artefact: Artefact
    weights: Mapping[str, float]

    @property
    def weights_in_words(self) -> str:
        """Its preference weights as on the command line, empty without any."""
        return ",".join(f"{name}={weight:g}" for name, weight in self.weights.items())

    @property
    def name(self) -> str:
        return f"{self.artefact.name}@{self.weights_in_words}" if self.weights_in_words else self.artefact.name

    @property
    def reference(self) -> str:
        """How the command line names it."""
        named = self.artefact.name if self.artefact.job_id is None else self.artefact.id
        return f"{named}@{self.weights_in_words}" if self.weights_in_words else named

    def policy(self, files: ArtefactStore) -> Policy:
        """What rolls out. Raises LearningError for weights that it cannot be conditioned on."""
        from backend.learning.policies.conditioned import ConditionedPolicy
        from backend.learning.policies.policy import Policy
        from backend.learning.preferences.objectives import preference_weights

        content = files.get(self.artefact.id)
        if self.artefact.kind == CONDITIONED:
            return ConditionedPolicy.from_bytes(content).at(preference_weights(self.weights))
        return Policy.from_bytes(content)


@dataclass(frozen=True)
class Asked:
    """What the address asks for: one or two sides in one scene. query: the same again, for the figure's files."""

    sides: tuple[Side, ...]
    scene_seed: int
    query: str


class Undrawable(ValueError):
    """What was asked cannot be drawn: a key below `flow.problems` and its values."""

    def __init__(self, key: str, **values: object) -> None:
        self.key, self.values = key, values
        super().__init__(key)


@router.get("/lab/flow-field")
def flow_field(request: Request, database: Db, files: Files, stage: bool = False) -> Response:
    """The form, and below it the figure, its numbers and the same scene in 3D."""
    from backend.learning.preferences.objectives import NAMES
    from backend.simulation.scenes import LARGEST_SEED

    t = services_of(request).texts.get(lab_language(request))
    asked = figure = token = problem = None
    with database.session() as s:
        choices = choices_of(s, rights_in(request))
    try:
        with database.session() as s:
            asked = asked_of(request, s)
        if asked is not None:
            policies = [side.policy(files) for side in asked.sides]
            figure = _drawn(request, t, asked, policies)[1]
            if stage:
                token = services_of(request).replays.grant(_replay(asked, policies))
    except Undrawable as wrong:
        problem = t(f"flow.problems.{wrong.key}", **wrong.values)
    except LearningError as wrong:
        problem = t("flow.problems.weights", message=str(wrong))
    except FigureError as wrong:
        problem = t("flow.problems.busy" if wrong.busy else "flow.problems.failed", message=str(wrong))
    given = request.query_params
    chosen = {side: given.get(f"policy_{side}", "") for side in SIDES}
    kind_of = {one.id: one.kind for one in choices}
    seed = asked.scene_seed if asked is not None else None
    return lab_page(
        request,
        "analyst/flow_field.html",
        status=422 if problem else 200,
        choices=choices,
        chosen=chosen,
        scene=given.get("scene") or str(first_scene()),
        conditioned=[side for side in SIDES if kind_of.get(chosen[side]) == CONDITIONED],
        objectives=NAMES,
        given=given,
        problem=problem,
        asked=asked,
        figure=figure,
        command=_command(asked) if asked else None,
        another=_query(given, scene=str(seed + 1)) if seed is not None and seed < LARGEST_SEED else None,
        replay=token,
    )


@router.get("/lab/flow-field/{name}", response_class=Response, responses=answers_with(*ENDINGS))
def flow_file(request: Request, name: str, database: Db, files: Files) -> Response:
    """One file of the figure that the rest of the address asks for."""
    t = services_of(request).texts.get(lab_language(request))
    try:
        with database.session() as s:
            asked = asked_of(request, s)
        if asked is None:
            raise LabRefusal(404, "no_figure")
        mark, figure = _drawn(request, t, asked, [side.policy(files) for side in asked.sides])
    except FigureError as wrong:
        if wrong.busy:
            return Response(status_code=503, headers={"Retry-After": "5"})
        raise LabRefusal(404, "no_figure") from None
    except (LearningError, Undrawable):
        raise LabRefusal(404, "no_figure") from None
    if name not in figure.files:
        raise LabRefusal(404, "no_figure")
    tag = f'"{mark}"'
    headers = {"ETag": tag, "Cache-Control": "private, no-cache", "Content-Security-Policy": FIGURE_POLICY}
    if request.headers.get("If-None-Match") == tag:
        return Response(status_code=304, headers=headers)
    ending = name.rpartition(".")[2]
    if ending != "png":
        headers["Content-Disposition"] = f'attachment; filename="{name}"'
    return Response(figure.files[name], media_type=MEDIA[ending], headers=headers)


def first_scene() -> int:
    """The first scene that is kept for figures."""
    from backend.learning.scene_sets import Purpose, first_seed

    return first_seed(Purpose.FIGURE, 0)


def choices_of(s: DatabaseSession, rights: Rights) -> Sequence[Artefact]:
    """The policies that can be drawn: what came with the product by name, then one's own, newest first."""
    rows = select(Artefact).where(Artefact.kind.in_(KINDS), offered(), seen_artefacts(rights))
    found = list(s.scalars(rows.order_by(Artefact.created_at.desc())))
    return sorted(found, key=lambda one: (one.job_id is not None, one.name if one.job_id is None else ""))


def asked_of(request: Request, s: DatabaseSession) -> Asked | None:
    """What the address asks for, None if it names no policy. Raises Undrawable, or LabRefusal for no such policy."""
    from backend.simulation.scenes import LARGEST_SEED

    given = request.query_params
    if not given.get("policy_a"):
        return None
    rights = rights_in(request)
    sides = [_side(given, s, side, rights) for side in SIDES if given.get(f"policy_{side}")]
    setups = sorted({side.artefact.setup or "" for side in sides})
    if len(setups) > 1:
        raise Undrawable("setups", first=sides[0].artefact.setup, second=sides[1].artefact.setup)
    if len(sides) == 2 and sides[0].reference == sides[1].reference:
        raise Undrawable("alike")
    scene = given.get("scene") or str(first_scene())
    if not scene.isdecimal() or not scene.isascii() or len(scene) > 16 or int(scene) > LARGEST_SEED:
        raise Undrawable("scene", value=scene, largest=str(LARGEST_SEED))
    return Asked(tuple(sides), int(scene), _query(given))


def _side(given: Mapping[str, str], s: DatabaseSession, side: str, rights: Rights) -> Side:
    from backend.learning.preferences.objectives import NAMES

    artefact = s.get(Artefact, given[f"policy_{side}"])
    if artefact is None or artefact.kind not in KINDS or not may_with(s, rights, Right.LOOK, artefact):
        raise LabRefusal(404, "no_artefact")
    if artefact.quarantined_at is not None:
        raise LabRefusal(410, "quarantined")
    weights = {name: _weight(given.get(f"{side}_{name}") or "0", name) for name in NAMES}
    some = {name: weight for name, weight in weights.items() if weight} if artefact.kind == CONDITIONED else {}
    return Side(artefact, some)


def _weight(value: str, name: str) -> float:
    try:
        weight = float(value)
    except ValueError:
        weight = math.nan
    if not 0 <= weight <= 1:
        raise Undrawable("weight", name=name, value=value)
    return weight


def _query(given: Mapping[str, str], **changed: str) -> str:
    from backend.learning.preferences.objectives import NAMES

    known = ["policy_a", "policy_b", "scene", *(f"{side}_{name}" for side in SIDES for name in NAMES)]
    said = {name: changed.get(name) or given.get(name) for name in known}
    return urlencode({name: value for name, value in said.items() if value})


def _drawn(request: Request, t: Catalogue, asked: Asked, policies: Sequence[Policy]) -> tuple[str, FigureFiles]:
    from backend.explain.flow_field import CELL_M

    order = FlowOrder(
        tuple((side.name, one.without_critic().to_bytes()) for side, one in zip(asked.sides, policies, strict=True)),
        asked.scene_seed,
        CELL_M,
        tuple((field.name, t.table("flow.words")[field.name]) for field in fields(Words)),
    )
    return services_of(request).figures.draw(order)


def _replay(asked: Asked, policies: Sequence[Policy]) -> Replay:
    from backend.simulation.fast import rollout
    from backend.simulation.scenes import draw_scene
    from backend.simulation.setups import get_setup

    setup = get_setup(policies[0].setup)
    scene = draw_scene(setup, asked.scene_seed)
    rollouts = tuple(rollout(setup, one.rollout_policy, [scene])[0] for one in policies)
    names = [f"{x.upper()}: {side.name}" for x, side in zip(SIDES, asked.sides, strict=False)]
    return Replay(rollouts, tuple(names) if len(names) > 1 else (asked.sides[0].name,))


def _command(asked: Asked) -> str:
    named = " ".join(side.reference for side in asked.sides)
    return f"desirepath flow-field {named} --scene {asked.scene_seed} --out flow_field"
