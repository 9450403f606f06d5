"""One workspace for what a policy does and why: tabs above one stage, with the policy, the scene and the view in the
address, kept while switching. Nothing has to be chosen first: each tab draws a default.

What a tab draws is its own (`flow_pages.py`, `explanation_pages.py`, `attention_pages.py`, `live_pages.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from fastapi import Request
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import RedirectResponse, Response

from desirepath.simulation.setups import preference_setups
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.models import Artefact
from desirepath.web.analyst.chosen_policies import (
    ADAPTABLE,
    KINDS,
    NAMED,
    SIDES,
    WEIGHED,
    Side,
    Undrawable,
    call,
    choices_of,
    find_policy,
    find_side,
    first_scene,
    is_of_before,
    named_in,
    objectives_of,
    problem_of,
    query_of,
    scene_in,
    weights_in,
)
from desirepath.web.analyst.compared_scenes import roll_out
from desirepath.web.core.dependencies import services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_language, lab_page, rights_in
from desirepath.web.stage.replay_stages import Shown
from desirepath_stage.views import VIEWS, View

if TYPE_CHECKING:  # the simulator comes with it; a server that starts need not wait for it
    from desirepath.simulation.trajectory import Trajectory
    from desirepath_stage.stage import Stage


@dataclass(frozen=True)
class Tab:
    """name: the last part of its address, and of its texts. title: a key. default: the shipped policy that it shows
    where none is named. pairs: whether it draws a second policy. kept: parameters of its own."""

    name: str
    title: str
    default: str
    shows: Callable[[Artefact], bool]
    pairs: bool = False
    kept: tuple[str, ...] = ()

    @property
    def path(self) -> str:
        return f"/lab/{self.name}"

    def nearest(self, choices: Sequence[Artefact], asked: Artefact | None) -> Artefact | None:
        """What it shows instead: a policy of the same setup, else its default, else whatever it can; None: nothing."""
        shown = [choice for choice in choices if self.shows(choice)]
        alike = [choice for choice in shown if asked is not None and choice.setup == asked.setup]
        return next((x for x in (*alike, *(y for y in shown if y.name == self.default), *shown)), None)


def by_hand(artefact: Artefact) -> bool:
    """Whether it has weights that there are sliders for: the nine of a person who stands, or chapter 5's three."""
    return artefact.kind == ADAPTABLE or (artefact.kind in WEIGHED and artefact.setup in preference_setups())


FLOW = Tab("flow-field", "flow.title", "study_room/base", lambda one: one.kind in KINDS, pairs=True)
EXPLAIN = Tab(
    "explain",
    "explanation.title",
    "study_room/base",
    lambda one: one.kind in KINDS and one.kind != "depth_controller",
    pairs=True,
    kept=("command", "method", "at"),
)
ATTENTION = Tab(
    "attention",
    "attention.title",
    "crowd_corridor/attention",
    lambda one: one.kind == "attention_policy",
    kept=("building", "plain"),
)
LIVE = Tab("live", "live.lab.title", "study_room/conditioned", by_hand)
TABS = (FLOW, EXPLAIN, ATTENTION, LIVE)


@dataclass(frozen=True)
class Asked:
    """What is drawn: one or two sides in one scene, seen so. instead_of: the policy that the address names and the tab
    cannot show. named: the policies as the address names them, by parameter."""

    sides: tuple[Side, ...]
    scene_seed: int
    view: View
    instead_of: Artefact | None
    named: dict[str, str]

    @property
    def query(self) -> str:
        """The same again, for what belongs to it."""
        shown = dict(zip(NAMED.values(), (side.address for side in self.sides), strict=False))
        return query_of(**shown, scene=self.scene_seed)

    def seen(self, **changed: object) -> str:
        """The address's parameters, on whichever tab, with something changed."""
        return query_of(**{**self.named, "scene": self.scene_seed, "view": self.view, **changed})


@dataclass(frozen=True)
class Made:
    """What a stage shows as soon as it stands there, one after the other; made only then, so that no page waits."""

    make: Callable[[], Iterable[Shown]]

    def show(self, stage: Stage) -> None:
        for shown in self.make():
            shown.show(stage)


def view_in(request: Request) -> View:
    return next((name for name in VIEWS if name == request.query_params.get("view")), VIEWS[0])


def find_asked(request: Request, s: DatabaseSession, tab: Tab) -> Asked | None:
    """What the address asks for on that tab, or its default; None where no policy is there that it can show. Raises
    Undrawable, or LabRefusal for no such policy."""
    scene = scene_in(request.query_params)
    first = find_side(request, s, "a")
    named = {NAMED["a"]: first.address} if first is not None else {}
    instead_of = None
    if first is None or not tab.shows(first.artefact):
        instead_of = first.artefact if first is not None else None
        rights = rights_in(request)
        nearest = tab.nearest(choices_of(s, rights), instead_of)
        if nearest is None:
            return None
        first = Side(nearest, {}, call(s, rights, [nearest])[nearest.id])
        named = named or {NAMED["a"]: first.address}
    sides = [first]
    second = find_side(request, s, "b")
    if second is not None:
        named[NAMED["b"]] = second.address
        if tab.pairs and instead_of is None:
            sides.append(second)
    if len({side.artefact.setup for side in sides}) > 1:
        raise Undrawable("setups", first=sides[0].artefact.setup, second=sides[1].artefact.setup)
    if len(sides) == len(SIDES) and sides[0].reference == sides[1].reference:
        raise Undrawable("alike")
    return Asked(tuple(sides), scene, view_in(request), instead_of, named)


def find_drawn(request: Request, s: DatabaseSession, tab: Tab) -> Asked:
    """The same for what belongs to a picture that a page shows: nothing is drawn instead. Raises Undrawable, or
    LabRefusal."""
    asked = find_asked(request, s, tab)
    if asked is None or asked.instead_of is not None:
        raise LabRefusal(404, "no_figure")
    return asked


def check_weights(files: ArtefactStore, asked: Asked) -> None:
    """Raises LearningError for weights on which a side cannot be conditioned."""
    for side in asked.sides:
        if side.weights:
            side.policy(files)


def roll_out_sides(files: ArtefactStore, asked: Asked) -> tuple[tuple[Trajectory, ...], tuple[str, ...]]:
    """From the scene's start, and what each is called beside the other."""
    rollouts = tuple(
        roll_out(files, side.artefact.id, side.weights_in_words, side.artefact.setup or "", asked.scene_seed)
        for side in asked.sides
    )
    names = tuple(f"{letter.upper()}: {side.name}" for letter, side in zip(SIDES, asked.sides, strict=False))
    return rollouts, names if len(names) > 1 else (asked.sides[0].name,)


def moved_on(request: Request, asked: Asked, tab: Tab) -> Response | None:
    """Where the address names the same in another way than addresses do now: the way to the one that does."""
    given = request.query_params
    names = {NAMED[side]: named_in(given, side) for side in SIDES if named_in(given, side)}
    if not is_of_before(given) and all(asked.named.get(key) == called for key, called in names.items()):
        return None
    own = [(name, value) for name, value in given.multi_items() if name in (*tab.kept, "corner") and value]
    more = "".join(f"&{query_of(**{name: value})}" for name, value in own)
    return RedirectResponse(f"{tab.path}?{asked.seen()}{more}", status_code=303)


def workspace_page(
    request: Request,
    database: Database,
    tab: Tab,
    asked: Asked | None,
    *,
    problem: str | None,
    shown: Shown | None,
    **own: Any,
) -> Response:
    """The tab's page around a stage with `shown` on it."""
    from desirepath.simulation.scenes import LARGEST_SEED

    services, given = services_of(request), request.query_params
    with database.session() as s:
        rights = rights_in(request)
        choices = [choice for choice in choices_of(s, rights) if tab.shows(choice)]
        names = call(s, rights, choices)
        chosen = {side: find_policy(s, rights, named_in(given, side).partition("@")[0]) for side in SIDES}
    for side, found in zip(SIDES, asked.sides if asked is not None else (), strict=False):
        chosen[side] = found.artefact
    weights = {side: weights_in(given, side) for side in SIDES}
    kept = {name: given[name] for name in tab.kept if given.get(name)}
    seed = asked.scene_seed if asked is not None else None
    return lab_page(
        request,
        f"analyst/{tab.name.replace('-', '_')}.html",
        status=422 if problem else 200,
        tab=tab,
        tabs=TABS,
        asked=asked,
        problem=problem,
        choices=choices,
        names=names,
        chosen={side: found.id if found is not None else "" for side, found in chosen.items()},
        weighed={
            side: objectives_of(found.kind, found.setup)
            for side, found in chosen.items()
            if found is not None and found.kind in WEIGHED
        },
        weights=weights,
        scene=given.get("scene") or str(first_scene()),
        view=view_in(request),
        views=VIEWS,
        kept=f"&{query_of(**kept)}" if kept else "",
        given=given,
        replay=services.replays.grant(shown) if shown is not None else None,
        scenes={
            step: asked.seen(scene=seed + by)
            for step, by in (("before", -1), ("after", 1))
            if asked is not None and seed is not None and 0 <= seed + by <= LARGEST_SEED
        },
        **own,
    )


def part(request: Request, template: str, *, problem: str | None, **own: Any) -> Response:
    """What belongs to a tab's picture and takes longer: the page fetches it when it is seen."""
    return lab_page(request, template, status=422 if problem else 200, problem=problem, **own)


def words_of(request: Request, wrong: Exception) -> str:
    """One of NOT_DRAWN in the page's language."""
    return problem_of(services_of(request).texts.get(lab_language(request)), wrong)
