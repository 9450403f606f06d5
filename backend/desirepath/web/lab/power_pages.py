"""How many people a study needs, asked from the page: of a draft before it is opened, and of a study that is there.

A form, and below it what was found or how far it is. The runs themselves are `power_runs.py`'s.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Form, Request
from pydantic import BaseModel, Field
from starlette.responses import RedirectResponse, Response

from desirepath.grammar.conditions import Ordered
from desirepath.grammar.texts import local
from desirepath.store.query_sets import query_sets_here
from desirepath.study.kinds.comparison import ComparisonStage
from desirepath.study.kinds.importance_ranking import ImportanceRankingStage
from desirepath.study.kinds.rating import RATING, RatingStage
from desirepath.study.protocol.freezing import FrozenProtocol, ProtocolError
from desirepath.study.session.versions import newest_protocol
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.dependencies import TheServices, services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_language, lab_page
from desirepath.web.core.media import FIGURE_ENDINGS, answers_with, figure_file
from desirepath.web.lab import power_runs
from desirepath.web.lab.new_study import TheDraft
from desirepath.web.lab.power_runs import NUMBERS, PowerAsked, PowerAskedError, TooManyError
from desirepath.web.lab.study_tabs import the_study

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["power"])
MORE = ("items_alike", "drop_out", "shown", "cohorts")  # fields that few will change


Written = Annotated[str, Field("", max_length=60)]
Named = Annotated[str, Field("", max_length=200)]


class PowerForm(BaseModel):
    """The form as it comes; what its fields can be is `power_runs.py`'s. Empty: left open."""

    participants: Written
    effect: Written
    first_choice: Written
    consistency: Written
    own: Written
    own_against_other: Written
    items_alike: Written
    drop_out: Written
    shown: Written
    tau: Written
    tau_gain: Written
    cohorts: Written
    condition: Named
    item: Named
    ranking: Named


@dataclass(frozen=True)
class _Subject:
    """What is asked about. here: the page's address; back: where it was come from; source: as `PowerRuns.begin` takes
    it; named: how the command names it."""

    frozen: FrozenProtocol
    here: str
    back: str
    source: str | Path
    named: str
    study: str | None = None


def _of_draft(services: TheServices, draft: TheDraft) -> _Subject:
    try:
        with services.database.session() as s:
            frozen = draft.freeze(query_sets_here(s))
    except ProtocolError:
        raise LabRefusal(422, "not_valid") from None
    here = f"/lab/new/{draft.id}"
    return _Subject(frozen, f"{here}/power", here, draft.folder, f"{frozen.protocol.protocol}.yaml")


def _of_study(services: TheServices, study_id: str) -> _Subject:
    with services.database.session() as s:
        study = the_study(s, study_id)
        frozen = newest_protocol(s, study)[1]
    here = f"/lab/studies/{study.id}"
    return _Subject(frozen, f"{here}/power", f"{here}/protocol", study.id, study.id, study.id)


@router.get("/lab/new/{draft_id}/power")
def draft_power(request: Request, services: TheServices, draft: TheDraft) -> Response:
    """The form; with numbers in the address also what was found with them. A fragment when asked for one."""
    return _power_page(request, _of_draft(services, draft))


@router.post("/lab/new/{draft_id}/power")
def begin_of_draft(
    request: Request, services: TheServices, draft: TheDraft, user: CheckedCsrf, form: Annotated[PowerForm, Form()]
) -> Response:
    return _begin(request, _of_draft(services, draft), form)


@router.get("/lab/new/{draft_id}/power/{name}", response_class=Response, responses=answers_with(*FIGURE_ENDINGS))
def draft_power_file(request: Request, services: TheServices, draft: TheDraft, name: str) -> Response:
    """The figure, or its rows."""
    return _file(request, _of_draft(services, draft), name)


@router.get("/lab/studies/{study_id}/power")
def study_power(request: Request, services: TheServices, study_id: str) -> Response:
    """The same of a study: of the protocol that whoever joins now gets."""
    return _power_page(request, _of_study(services, study_id))


@router.post("/lab/studies/{study_id}/power")
def begin_of_study(
    request: Request, services: TheServices, study_id: str, user: CheckedCsrf, form: Annotated[PowerForm, Form()]
) -> Response:
    return _begin(request, _of_study(services, study_id), form)


@router.get("/lab/studies/{study_id}/power/{name}", response_class=Response, responses=answers_with(*FIGURE_ENDINGS))
def study_power_file(request: Request, services: TheServices, study_id: str, name: str) -> Response:
    """The figure, or its rows."""
    return _file(request, _of_study(services, study_id), name)


def _power_page(
    request: Request,
    subject: _Subject,
    *,
    given: dict[str, str] | None = None,
    problem: PowerAskedError | None = None,
    busy: bool = False,
) -> Response:
    asked, run = PowerAsked(), None
    if given is None:
        given = dict(request.query_params)
        try:
            asked = PowerAsked.of(given, _places(subject.frozen))
        except PowerAskedError as wrong:
            problem = wrong
        run = _runs(request).find(subject.frozen.hash, asked) if given and problem is None else None
    shown: dict[str, Any] = {
        "subject": subject,
        "run": run,
        "assumptions": _assumptions(subject.frozen, asked, run),
        "files": f"{subject.here}/{{}}?{urlencode(asked.query)}",
        "command": asked.command(subject.named),
    }
    if request.headers.get("X-Fragment"):
        return lab_page(request, "lab/power_part.html", **shown)
    return lab_page(
        request,
        "lab/power.html",
        status=422 if problem else 503 if busy else 200,
        given=asked.query | given,
        fields={name: NUMBERS[name] for name in _fields(subject.frozen)},
        places={name: there for name, there in _places(subject.frozen).items() if len(there) > 1},
        worded=_item_words(subject.frozen, lab_language(request)),
        more=MORE,
        problem=problem,
        busy=busy,
        live=f"{subject.here}?{urlencode(asked.query)}",
        fewest=power_runs.FEWEST,
        most=power_runs.MOST,
        **shown,
    )


def _item_words(frozen: FrozenProtocol, language: str) -> dict[str, str]:
    """Key of an item -> its question."""
    items = (item for asked in frozen.questionnaires.values() for item in asked.items)
    return {item.key: local(item.text, language) for item in items}


def _fields(frozen: FrozenProtocol) -> list[str]:
    """Which numbers matter for this protocol."""
    comparison = frozen.protocol.stage_of(ComparisonStage)
    left_out = set() if comparison is not None else {"own", "shown"}
    if comparison is None or "other" not in comparison.opponents:
        left_out.add("own_against_other")
    if frozen.protocol.stage_of(ImportanceRankingStage) is None:
        left_out |= {"tau", "tau_gain"}
    return [name for name in NUMBERS if name not in left_out]


def _assumptions(frozen: FrozenProtocol, asked: PowerAsked, run: power_runs.PowerRun | None) -> dict[str, float]:
    """What the studies of a run were made up with, by field: of those that the design has something for."""
    if run is None or "design" not in run.result:
        return {}
    found, design, given = run.result["assumed"], run.result["design"], dict(asked.numbers)
    left_out = {"cohorts"}
    if not found["item"]:
        left_out |= {"effect", "items_alike"}
    if not (found["ranking"] and found["condition"]):
        left_out.add("first_choice")
    if not design["queries"]:
        left_out.add("consistency")
    usual = {name: given.get(name, NUMBERS[name].usual) for name in _fields(frozen) if name not in left_out}
    return {name: value for name, value in usual.items() if value is not None}


def _places(frozen: FrozenProtocol) -> dict[str, list[str]]:
    """Where an effect can be assumed, by keys: conditions and levels of factors, what is rated, what is ranked."""
    stages = [stage for stage in frozen.protocol.all_stages if isinstance(stage, Ordered)]
    factors = [of for stage in stages for of in (stage.each, stage.one_of) if of]
    levels = [level for of in factors for there in of.values() for level in there]
    named = [cell.name for stage in stages for group in range(len(stage.groups)) for cell in stage.conditions(group)]
    blocks = [block for of in frozen.questionnaires.values() for block in of.blocks]
    items = [item for block in blocks for item in block.items]
    rated = [item.key for item in items if item.type == "scale" and item.instructed is None]
    scales = [block.scale for block in blocks if block.scale]
    shown = [RATING] if any(isinstance(stage, RatingStage) for stage in stages) else []
    ranked = [item.key for item in items if item.type == "ranking"]
    found = {"condition": [*named, *levels], "item": [*rated, *scales, *shown], "ranking": ranked}
    return {name: [key for key in dict.fromkeys(there) if key] for name, there in found.items()}


def _begin(request: Request, subject: _Subject, form: PowerForm) -> Response:
    given = form.model_dump()
    try:
        asked = PowerAsked.of(given, _places(subject.frozen))
        _runs(request).begin(subject.frozen.hash, asked, subject.source)
    except PowerAskedError as wrong:
        return _power_page(request, subject, given=given, problem=wrong)
    except TooManyError:
        return _power_page(request, subject, given=given, busy=True)
    return RedirectResponse(f"{subject.here}?{urlencode(asked.query)}#result", status_code=303)


def _file(request: Request, subject: _Subject, name: str) -> Response:
    try:
        run = _runs(request).find(subject.frozen.hash, PowerAsked.of(request.query_params, _places(subject.frozen)))
    except PowerAskedError:
        run = None
    if run is None or name not in run.files:
        raise LabRefusal(404, "no_figure")
    return figure_file(request, name, run.files[name], shown=("png", "svg"))


def _runs(request: Request) -> power_runs.PowerRuns:
    return services_of(request).power
