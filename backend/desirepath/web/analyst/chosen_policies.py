"""Which policies, scene and view an address asks for, in the workspace that draws one policy in a scene, or two.

An address has their names, as in `policy=study_room/conditioned@farther=1&scene=3500000000&view=immersive`, and means
the same on every tab (`workspace.py`); what is drawn is the tabs' own, and so is what cannot be drawn of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING
from urllib.parse import urlencode

from fastapi import Request
from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import Response

from desirepath.learning.errors import LearningError
from desirepath.store.artefact_upkeep import is_offered
from desirepath.store.artefacts import ArtefactStore
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
NAMED = {"a": "policy", "b": "second"}  # side -> its name in an address
CONDITIONED, ADAPTABLE = "conditioned_policy", "adaptable_policy"
WEIGHED = (CONDITIONED, ADAPTABLE)
TELLING = 4
"""The first scene in which what each tab shows by itself arrives and passes somebody, and what is explained slows down:
tests/web/test_first_scene.py holds it to that."""
KINDS = ("policy", *WEIGHED, "attention_policy", "depth_controller")


@dataclass(frozen=True)
class Side:
    """One policy of the figure: what was chosen and, for a conditioned one, what it is told. called: its name in an
    address."""

    artefact: Artefact
    weights: Mapping[str, float]
    called: str = ""

    @property
    def weights_in_words(self) -> str:
        """Its preference weights as on the command line, empty without any."""
        return ",".join(f"{name}={weight:g}" for name, weight in self.weights.items())

    @property
    def name(self) -> str:
        return self._weighed(self.artefact.name)

    @property
    def reference(self) -> str:
        """How the command line names it."""
        return self._weighed(shipped_name(self.artefact.id) or self.artefact.id)

    @property
    def address(self) -> str:
        """How an address names it."""
        return self._weighed(self.called)

    def _weighed(self, name: str) -> str:
        return f"{name}@{self.weights_in_words}" if self.weights_in_words else name

    def policy(self, files: ArtefactStore) -> DrivingPolicy:
        """What rolls out. Raises LearningError for weights that it cannot be conditioned on."""
        from desirepath.learning.policies.shipped import policy_conditioned_on

        return policy_conditioned_on(files.get(self.artefact.id), self.reference)


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


def objectives_of(kind: str, setup: str | None = None) -> tuple[str, ...]:
    """What a policy of that kind is conditioned on: nine objectives, of the setup's, chapter 5's three, or nothing."""
    from desirepath.learning.adaptable.objectives import NAMES as THREE
    from desirepath.learning.preferences.objectives import NAMES, names_of

    return {CONDITIONED: names_of(setup) if setup else NAMES, ADAPTABLE: THREE}.get(kind, ())


def first_scene() -> int:
    """The first of the figures' scenes that is a good show on every tab (`TELLING`)."""
    from desirepath.learning.scene_sets import Purpose, first_seed

    return first_seed(Purpose.FIGURE, 0) + TELLING


def choices_of(s: DatabaseSession, rights: Rights) -> Sequence[Artefact]:
    """The policies that can be drawn: what came with the product by name, then one's own, newest first."""
    rows = select(Artefact).where(Artefact.kind.in_(KINDS), is_offered(), seen_artefacts(rights))
    found = list(s.scalars(rows.order_by(Artefact.created_at.desc())))
    own = {one.id: one.job_id is not None or "imported" in one.card for one in found}
    return sorted(found, key=lambda one: (own[one.id], "" if own[one.id] else one.name))


def named_in(given: Mapping[str, str], side: str) -> str:
    """How an address names that side's policy, empty: not at all. Addresses of before said `policy_a`."""
    return given.get(NAMED[side]) or given.get(f"policy_{side}", "")


def is_of_before(given: Mapping[str, str]) -> bool:
    """Whether an address, or a form, says in several parameters what one says now."""
    return any(
        name in given or any(one.startswith(f"{name[-1]}_") for one in given) for name in ("policy_a", "policy_b")
    )


def call(s: DatabaseSession, rights: Rights, artefacts: Iterable[Artefact]) -> dict[str, str]:
    """Id -> the name by which addresses know it: as it was shipped, its own where nothing else is called so, else its
    id."""
    found = list(artefacts)
    rows = select(Artefact.name, func.count()).where(Artefact.kind.in_(KINDS), seen_artefacts(rights))
    alike = dict(s.execute(rows.group_by(Artefact.name)).tuples().all())

    def name_of(one: Artefact) -> str:
        alone = alike.get(one.name) == 1 and "@" not in one.name and find_artefact(s, one.name) is None
        return shipped_name(one.id) or (one.name if alone else one.id)

    return {one.id: name_of(one) for one in found}


def find_policy(s: DatabaseSession, rights: Rights, called: str) -> Artefact | None:
    """The artefact of that id, shipped name, or name that no other policy has; None where there is none."""
    if (artefact := find_artefact(s, called)) is not None:
        return artefact
    rows = select(Artefact).where(Artefact.kind.in_(KINDS), Artefact.name == called, seen_artefacts(rights)).limit(2)
    found = list(s.scalars(rows))
    return found[0] if len(found) == 1 else None


def find_side(request: Request, s: DatabaseSession, side: str) -> Side | None:
    """That side as the address names it, None: it names none. Raises Undrawable, or LabRefusal for no such policy."""
    given, rights = request.query_params, rights_in(request)
    called, _, _ = named_in(given, side).partition("@")
    if not called:
        return None
    artefact = find_policy(s, rights, called)
    if artefact is None or artefact.kind not in KINDS or not may_with(s, rights, Right.LOOK, artefact):
        raise LabRefusal(404, "no_artefact")
    if artefact.quarantined_at is not None:
        raise LabRefusal(410, "quarantined")
    said = weights_in(given, side)
    known = objectives_of(artefact.kind, artefact.setup)
    weights = {name: _weight(said.get(name) or "0", name) for name in known}
    called = call(s, rights, [artefact])[artefact.id]
    return Side(artefact, {name: weight for name, weight in weights.items() if weight}, called)


def weights_in(given: Mapping[str, str], side: str) -> dict[str, str]:
    """The weights of that side as an address writes them: behind `@`, or each for itself, which counts more."""
    pairs = (share.partition("=") for share in named_in(given, side).partition("@")[2].split(",") if share)
    own = {name.strip(): weight.strip() for name, _, weight in pairs}
    return own | {name.removeprefix(f"{side}_"): value for name, value in given.items() if name.startswith(f"{side}_")}


def _weight(value: str, name: str) -> float:
    try:
        weight = float(value)
    except ValueError:
        weight = math.nan
    if not 0 <= weight <= 1:
        raise Undrawable("weight", name=name, value=value)
    return weight


def scene_in(given: Mapping[str, str]) -> int:
    """The seed of the scene, the first of the figures' where none is named. Raises Undrawable."""
    from desirepath.simulation.scenes import LARGEST_SEED

    scene = given.get("scene") or str(first_scene())
    if not scene.isdecimal() or not scene.isascii() or len(scene) > 16 or int(scene) > LARGEST_SEED:
        raise Undrawable("scene", value=scene, largest=str(LARGEST_SEED))
    return int(scene)


def query_of(**parameters: object) -> str:
    """An address's parameters, those that say something; names stay readable."""
    return urlencode({name: value for name, value in parameters.items() if value not in ("", None)}, safe="/@=,:")
