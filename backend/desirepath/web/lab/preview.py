"""Looking at a protocol as a participant will: real pages, real trajectories, nothing stored. For drafts and for
studies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

from fastapi import APIRouter, Depends, Request
from starlette.responses import Response

from desirepath.explain.shown_explanation import Scores, ShownAttention, ShownExplanation, is_of_people
from desirepath.grammar.words import LABEL_S
from desirepath.simulation.setups import setups_with
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.artefacts import SHA256, ArtefactError, ArtefactStore
from desirepath.store.models import Study
from desirepath.store.payment_codes import REMOVED
from desirepath.store.query_sets import query_sets_here
from desirepath.store.sides import SIDES, Side, is_side
from desirepath.study.kind import Page, kind_of
from desirepath.study.kinds.order import COLOURS, OrderStep
from desirepath.study.kinds.trial import viewing_in
from desirepath.study.personalising.several_drives import fill_up
from desirepath.study.protocol.freezing import FrozenProtocol, ProtocolError
from desirepath.study.protocol.planning import Step, example_queries, make_plan
from desirepath.study.revising import query_sets_for
from desirepath.study.session.machine import StepView
from desirepath.study.session.versions import newest_protocol
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.dependencies import Db, Services, TheServices, contact, page, services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_language
from desirepath.web.core.roles import Right
from desirepath.web.lab.drafts import find_draft
from desirepath.web.participant.session_view import leads_to, next_kind

if TYPE_CHECKING:
    from desirepath_stage.stage import Stage
    from desirepath_stage.views import View

EXAMPLE_CODE = "EXAMPLE"  # stands where a participant's own and completion code will

router = APIRouter(prefix="/lab", dependencies=[Depends(check_csrf)], tags=["preview"])


@dataclass(frozen=True)
class QueryPreview:
    """A query on a stage: still at first, then the trajectory that is asked for. alone: only A, without a letter;
    goal: it is shown, with a trail; explained: with what is shown of the policy's reasons. several: all of an order.
    """

    a: Trajectory
    b: Trajectory
    view: View
    alone: bool = False
    goal: bool = True
    explained: ShownExplanation | None = None
    several: tuple[Trajectory, ...] = ()

    def show(self, stage: Stage) -> None:
        if self.several:
            stage.several(self.view, self.several, COLOURS)
            return
        pair = (self.a, self.b)
        stage.show(self.a.scene, self.view, trajectories=pair, goal=self.goal, explained=self.explained)

    def play(self, stage: Stage, side: Side) -> None:
        stage.play(
            self.a if side == "a" else self.b,
            label="" if self.alone else side.upper(),
            label_s=0.0 if self.alone else LABEL_S,
            view=self.view,
            playback_id=side,
            trajectories=(self.a, self.b),
            goal=self.goal,
            explained=self.explained,
        )


@dataclass(frozen=True)
class Example:
    """What a preview shows: two trajectories of one scene, or one twice with its objects and their scores."""

    a: Trajectory
    b: Trajectory
    things: tuple[str, ...] = ()
    scores: Scores = ()
    attention: ShownAttention | None = None

    @property
    def videos(self) -> dict[Side, str] | None:
        """Where they are, of trajectories that videos show."""
        return videos_in(self.a, self.b)

    def explain(self, step: Step) -> ShownExplanation | None:
        """As much of the scores as the step shows."""
        if not self.things:
            return None
        outline, lidar, looked = (bool(getattr(step, name, False)) for name in ("outline", "lidar", "attention"))
        outline = outline and not is_of_people(self.things)
        return ShownExplanation(self.things, self.scores, outline, lidar, attention=self.attention if looked else None)


def videos_in(a: Trajectory, b: Trajectory) -> dict[Side, str] | None:
    """Where signed-in people find the videos of A and B, None where the stage shows them."""
    shown = [one.recorded.video if one.recorded else None for one in (a, b)]
    return {side: f"/lab/videos/{one.sha256}" for side, one in zip(SIDES, shown, strict=True) if one} or None


def preview_steps(frozen: FrozenProtocol) -> list[Step]:
    """One step of every sort that a session has, in its order: the first of each stage, condition, kind and role."""
    steps: dict[tuple[str, ...], Step] = {}
    for step in make_plan(frozen.protocol, 0, example_queries(frozen.protocol)):
        steps.setdefault(step.sort, step)
    return list(steps.values())


def first_steps(frozen: FrozenProtocol) -> dict[str, int]:
    """Stage -> number (from 1) of its first step in the preview."""
    numbers: dict[str, int] = {}
    for number, step in enumerate(preview_steps(frozen), 1):
        numbers.setdefault(step.stage, number)
    return numbers


@lru_cache(maxsize=4)
def example_query(files: ArtefactStore, query_set: str) -> Example | None:
    """The first query of a query set, or rollout of a ranking set (shipped name, path, or id of one made here), None
    where the set cannot be read; the check of the protocol says why.
    """
    from desirepath.explain.methods import AttributionError
    from desirepath.explain.ranking_sets import RankingSet, is_ranking_set
    from desirepath.learning.errors import LearningError  # torch comes with it: only where somebody looks
    from desirepath.learning.queries.queries import QuerySet
    from desirepath.learning.shipped_files import resolve

    try:
        content = files.get(query_set) if SHA256.fullmatch(query_set) else resolve(query_set).read_bytes()
        if is_ranking_set(content):
            one = RankingSet.from_bytes(content).rollouts[0]
            scores = tuple(tuple(float(score) for score in moment) for moment in one.scores)
            looked = [tuple(tuple(float(weight) for weight in row) for row in part) for part in one.attention or ()]
            return Example(
                one.trajectory, one.trajectory, one.things, scores, ShownAttention(*looked) if looked else None
            )
        queries = QuerySet.from_bytes(content).queries
    except (AttributionError, LearningError, ArtefactError, OSError):
        return None
    return Example(queries[0].trajectory_a, queries[0].trajectory_b) if queries else None


@router.get("/new/{draft_id}/preview/{number}")
def preview_draft(request: Request, services: TheServices, draft_id: str, number: int, language: str = "") -> Response:
    return _preview_page(request, _drafted(services, draft_id), number, language, back=f"/lab/new/{draft_id}")


@router.get("/studies/{study_id}/revise/{draft_id}/preview/{number}")
def preview_change(
    request: Request, services: TheServices, study_id: str, draft_id: str, number: int, language: str = ""
) -> Response:
    back = f"/lab/studies/{study_id}/revise/{draft_id}"
    drafted = _drafted(services, draft_id, study_id)
    return _preview_page(request, drafted, number, language, back=back, study_id=study_id)


def _drafted(services: Services, draft_id: str, study_id: str | None = None) -> FrozenProtocol:
    """study_id: of which it is to be the next protocol."""
    draft = find_draft(services.settings.data, draft_id)
    if draft is None:
        raise LabRefusal(404, "no_draft")
    try:
        with services.database.session() as s:
            study = s.get(Study, study_id) if study_id is not None else None
            if study is None:
                return draft.freeze_valid(query_sets_here(s))[0]
            return draft.freeze(query_sets_for(s, study))
    except ProtocolError:
        raise LabRefusal(422, "not_valid") from None


@router.get("/studies/{study_id}/preview/{number}")
def preview_study(request: Request, study_id: str, number: int, database: Db, language: str = "") -> Response:
    with database.session() as s:
        study = s.get(Study, study_id)
        if study is None:
            raise LabRefusal(404, "no_study")
        newest = newest_protocol(s, study)[1]
        back = f"/lab/studies/{study.id}/protocol"
        return _preview_page(request, newest, number, language, back=back, study_id=study.id)


@router.post("/preview-stage/{token}/{side}", status_code=204)
def play(services: TheServices, token: str, side: str, user: CheckedCsrf) -> None:
    """Play trajectory `a` or `b` on a preview's stage."""
    if not is_side(side) or not services.presenter.play_replay(token, side):
        raise LabRefusal(404, "no_preview")


def _preview_page(
    request: Request, frozen: FrozenProtocol, number: int, language: str, *, back: str, study_id: str | None = None
) -> Response:
    steps = preview_steps(frozen)
    if not 1 <= number <= len(steps):
        raise LabRefusal(404, "no_stage", stages=len(steps))
    languages: Sequence[str] = frozen.protocol.languages
    if language not in languages:
        language = wish if (wish := lab_language(request)) in languages else languages[0]
    step = steps[number - 1]
    query_set = frozen.query_set
    shown = kind_of(step).previewed and query_set is not None
    query = example_query(services_of(request).files, query_set or "") if shown else None
    payload = kind_of(step).payload(step, Page(frozen, language, EXAMPLE_CODE))
    if query is not None and query.things:
        payload["things"] = list(query.things)
    several: tuple[Trajectory, ...] = ()
    if query is not None and isinstance(step, OrderStep) and not query.videos:
        several = _several(query, step.of, frozen.protocol.sample.longest_s)
        payload |= {"of": len(several), "durations_s": [one.duration_s for one in several]}
    if payload.get("return_url") and not request.state.sign_in.may(Right.TAKE, study_id):
        payload["return_url"] = REMOVED["return_url"]  # a fixed completion code may stand in it
    return page(
        request,
        "lab/preview.html",
        reasons=None,
        policies=[],
        language=language,
        step=StepView(
            kind=step.kind,
            key=step.key,
            index=number - 1,
            total=len(steps),
            payload=payload,
        ),
        next_kind=next_kind(steps, number - 1),
        leads_to=leads_to(steps, number - 1),
        stage_name=step.stage,
        number=number,
        steps=steps,
        languages=languages,
        study_title=frozen.title(language),
        code=f"P-{EXAMPLE_CODE}",
        contact=frozen.protocol.contact or contact(request),
        back=back,
        here=request.url.path.rsplit("/", 1)[0],
        lab=services_of(request).texts.get(lab_language(request)),
        stage_token=_granted(request, query, step, several) if query and not query.videos else None,
        videos=query.videos if query else None,
        durations=_durations(step, query),
        csrf=request.state.sign_in.csrf,
    )


def _several(query: Example, of: int, longest_s: float | None) -> tuple[Trajectory, ...]:
    """So many of the query's scene; its two alone where no policy drives there in other ways, which opening a study
    refuses."""
    pair = [query.a, query.b]
    return tuple(fill_up(pair, of, longest_s) if query.a.scene.setup in setups_with("conditioned") else pair)


def _durations(step: Step, query: Example | None) -> list[float]:
    """Of what the step shows of the example query, seconds; zeros where there is none, nothing on a page."""
    kind = kind_of(step)
    known = [round(trajectory.duration_s, 1) for trajectory in (query.a, query.b)] if query else [0.0, 0.0]
    return known[: kind.trajectories] if kind.previewed else []


def _granted(request: Request, query: Example, step: Step, several: tuple[Trajectory, ...]) -> str:
    """The token of a stage that shows the example query in the step's view."""
    alone = kind_of(step).trajectories == 1
    view, goal, explained = step.view or "top_down", viewing_in(step).goal_and_trail, query.explain(step)
    shown = QueryPreview(query.a, query.b, view, alone=alone, goal=goal, explained=explained, several=several)
    return services_of(request).replays.grant(shown)
