"""Which policies and which scene an address asks for, on pages that draw one policy in a scene, or two.

Conditioned policies are chosen with their weights. What is drawn of them is the pages' own (`flow_pages.py`,
`explanation_pages.py`), and so is what cannot be drawn of their own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

from fastapi import Request
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import Response

from desirepath.learning.errors import LearningError
from desirepath.store.artefact_upkeep import is_offered
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.models import Artefact
from desirepath.store.shipped_policies import find_artefact, shipped_name
from desirepath.web.core.catalogues import Catalogue
from desirepath.web.core.figure_process import FigureError
from desirepath.web.core.lab_frame import LabRefusal, rights_in
from desirepath.web.core.permits import may_with, seen_artefacts
from desirepath.web.core.roles import Right, Rights

if TYPE_CHECKING:  # the simulator comes with it; a server that starts need not wait for it
    from desirepath.learning.policies.policy import DrivingPolicy

SIDES = ("a", "b")
CONDITIONED, ADAPTABLE = "conditioned_policy", "adaptable_policy"
WEIGHED = (CONDITIONED, ADAPTABLE)
KINDS = ("policy", *WEIGHED, "attention_policy", "depth_controller")


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
        named = shipped_name(self.artefact.id) or self.artefact.id
        return f"{named}@{self.weights_in_words}" if self.weights_in_words else named

    def policy(self, files: ArtefactStore) -> DrivingPolicy:
        """What rolls out. Raises LearningError for weights that it cannot be conditioned on."""
        from desirepath.learning.policies.shipped import policy_conditioned_on

        return policy_conditioned_on(files.get(self.artefact.id), self.reference)


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


NOT_DRAWN = (Undrawable, LearningError, FigureError)
"""What a figure of chosen policies may fail with."""


def problem_of(t: Catalogue, wrong: Exception) -> str:
    """One of NOT_DRAWN in the page's words."""
    if isinstance(wrong, Undrawable):
        return t(f"flow.problems.{wrong.key}", **wrong.values)
    if isinstance(wrong, FigureError):
        return t("flow.problems.busy" if wrong.busy else "flow.problems.failed", message=str(wrong))
    return t("flow.problems.weights", message=str(wrong))


def no_file(wrong: Exception) -> Response:
    """The answer for a file of a figure that cannot be drawn now. Raises LabRefusal where it never can."""
    if isinstance(wrong, FigureError) and wrong.busy:
        return Response(status_code=503, headers={"Retry-After": "5"})
    raise LabRefusal(404, "no_figure") from None


def form_of(request: Request, database: Database) -> dict[str, Any]:
    """What the form on such a page is drawn from (`analyst/chosen_policies.html`)."""
    with database.session() as s:
        choices = choices_of(s, rights_in(request))
        given = name_by_id(s, request.query_params)
    chosen = {side: given.get(f"policy_{side}", "") for side in SIDES}
    chosen_of = {choice.id: choice for choice in choices}
    return {
        "choices": choices,
        "chosen": chosen,
        "scene": given.get("scene") or str(first_scene()),
        "weighed": {
            side: objectives_of(one.kind, one.setup)
            for side in SIDES
            if (one := chosen_of.get(chosen[side])) is not None and one.kind in WEIGHED
        },
        "given": given,
    }


def objectives_of(kind: str, setup: str | None = None) -> tuple[str, ...]:
    """What a policy of that kind is conditioned on: nine objectives, of the setup's, chapter 5's three, or nothing."""
    from desirepath.learning.adaptable.objectives import NAMES as THREE
    from desirepath.learning.preferences.objectives import NAMES, names_of

    return {CONDITIONED: names_of(setup) if setup else NAMES, ADAPTABLE: THREE}.get(kind, ())


def first_scene() -> int:
    """The first scene that is kept for figures."""
    from desirepath.learning.scene_sets import Purpose, first_seed

    return first_seed(Purpose.FIGURE, 0)


def choices_of(s: DatabaseSession, rights: Rights) -> Sequence[Artefact]:
    """The policies that can be drawn: what came with the product by name, then one's own, newest first."""
    rows = select(Artefact).where(Artefact.kind.in_(KINDS), is_offered(), seen_artefacts(rights))
    found = list(s.scalars(rows.order_by(Artefact.created_at.desc())))
    own = {one.id: one.job_id is not None or "imported" in one.card for one in found}
    return sorted(found, key=lambda one: (own[one.id], "" if own[one.id] else one.name))


def find_asked(request: Request, s: DatabaseSession) -> Asked | None:
    """What the address asks for, None if it names no policy. Raises Undrawable, or LabRefusal for no such policy."""
    from desirepath.simulation.scenes import LARGEST_SEED

    given = name_by_id(s, request.query_params)
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
    return Asked(tuple(sides), int(scene), query_of(given))


def name_by_id(s: DatabaseSession, params: Mapping[str, str]) -> dict[str, str]:
    """An address's parameters with policies by id, however it names them.

    Of `policy_a=study_room/conditioned@farther=1` that policy's id, and `a_farther=1`."""
    given = dict(params)
    for side in SIDES:
        called, _, weights = given.get(f"policy_{side}", "").partition("@")
        if (artefact := find_artefact(s, called)) is not None:
            pairs = (share.partition("=") for share in weights.split(",") if share)
            own = {f"{side}_{name.strip()}": weight.strip() for name, _, weight in pairs}
            given = {**own, **given, f"policy_{side}": artefact.id}
    return given


def _side(given: Mapping[str, str], s: DatabaseSession, side: str, rights: Rights) -> Side:
    artefact = s.get(Artefact, given[f"policy_{side}"])
    if artefact is None or artefact.kind not in KINDS or not may_with(s, rights, Right.LOOK, artefact):
        raise LabRefusal(404, "no_artefact")
    if artefact.quarantined_at is not None:
        raise LabRefusal(410, "quarantined")
    weights = {
        name: _weight(given.get(f"{side}_{name}") or "0", name) for name in objectives_of(artefact.kind, artefact.setup)
    }
    return Side(artefact, {name: weight for name, weight in weights.items() if weight})


def _weight(value: str, name: str) -> float:
    try:
        weight = float(value)
    except ValueError:
        weight = math.nan
    if not 0 <= weight <= 1:
        raise Undrawable("weight", name=name, value=value)
    return weight


def query_of(given: Mapping[str, str], **changed: str) -> str:
    from desirepath.learning.preferences.objectives import CROWD_NAMES

    names = dict.fromkeys([*(name for kind in WEIGHED for name in objectives_of(kind)), *CROWD_NAMES])
    known = ["policy_a", "policy_b", "scene", *(f"{side}_{name}" for side in SIDES for name in names)]
    parameters = {name: changed.get(name) or given.get(name) for name in known}
    return urlencode({name: value for name, value in parameters.items() if value})
