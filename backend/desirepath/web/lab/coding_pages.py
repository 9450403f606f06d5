"""The lab's pages for reading open questions: the codebook, coding one answer after the other, settling differences.

Rules and what is shown to a coder stand in `study/coding.py`. A coder's page has the text alone: no participant, no
condition, no time, and nothing of what the other coder said.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Annotated

from fastapi import APIRouter, Depends, Form, Request
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import RedirectResponse, Response

from desirepath.store.database import Database
from desirepath.store.dataset.coding_rows import codebook_of, coding_rows
from desirepath.store.dataset.tables import CODINGS
from desirepath.store.models import Participant, Study
from desirepath.store.models import Response as ResponseRow
from desirepath.store.models import Session as SessionRow
from desirepath.store.who_counts import GROUPS, Group, left_out_of_study, not_left_out
from desirepath.study import coding
from desirepath.study.coding import CodedAnswer, CodingError, OpenQuestion
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.dependencies import Db
from desirepath.web.core.lab_frame import LabRefusal
from desirepath.web.core.media import csv_response
from desirepath.web.lab.study_tabs import study_tab, the_study

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["experimenter"])


def _question(s: DatabaseSession, study: Study, item: str) -> OpenQuestion:
    for question in coding.open_questions(s, study):
        if question.item == item:
            return question
    raise LabRefusal(404, "no_question")


def _group(s: DatabaseSession, study: Study, asked: str) -> Group:
    """Whose answers: those asked for, else people's, else the simulated ones' where no person has written anything."""
    for group in GROUPS:
        if asked == group:
            return group
    questions = coding.open_questions(s, study)
    for group in ("people", "simulated", "pilot"):
        if any(coding.answers_to(s, study, question.item, group) for question in questions):
            return group
    return "people"


def _refused(problem: CodingError) -> LabRefusal:
    return LabRefusal(
        404 if problem.code in ("no_answer", "no_code") else 409, f"coding_{problem.code}", **problem.values
    )


@contextmanager
def _changing(database: Database, study_id: str, item: str) -> Iterator[tuple[DatabaseSession, Study]]:
    """A transaction on the codes of a question; what coding refuses is told as the lab's pages do."""
    with database.transaction() as s:
        study = the_study(s, study_id)
        _question(s, study, item)
        try:
            yield s, study
        except CodingError as problem:
            raise _refused(problem) from None


@router.get("/lab/studies/{study_id}/coding")
def questions(request: Request, study_id: str, database: Db, who: str = "") -> Response:
    """Every open question: how far it is coded, its codebook, agreement, how often each code was given."""
    with database.session() as s:
        study = the_study(s, study_id)
        group = _group(s, study, who)
        coded = [coding.summarise_question(s, study, question, group) for question in coding.open_questions(s, study)]
        return study_tab(request, study, "coding", who=group, groups=GROUPS, coded=coded, role_for=coding.role_for)


@router.get("/lab/studies/{study_id}/coding/{item}")
def code_next(request: Request, study_id: str, item: str, database: Db, who: str = "", answer: str = "") -> Response:
    """One answer to code: the next, or one that this coder has coded before."""
    with database.session() as s:
        return _answer_page(request, s, the_study(s, study_id), item, who, answer)


def _answer_page(
    request: Request,
    s: DatabaseSession,
    study: Study,
    item: str,
    who: str,
    answer: str,
    refused: Collection[str] | None = None,
) -> Response:
    """refused: the codes that were ticked where the form came without a decision; shown again beside the reason."""
    name = request.state.sign_in.name
    question, group = _question(s, study, item), _group(s, study, who)
    role = coding.role_for(coding.coders_of(s, study, item), name)
    if role is None:
        raise _refused(CodingError("two_others_code"))
    answers = coding.answers_to(s, study, item, group)
    done = [coded for coded in answers if role in coded.codes]
    shown = next((coded for coded in done if coded.response == answer), None) or coding.next_for(answers, role, name)
    given = shown.codes.get(role, frozenset()) if shown else frozenset()
    changeable = [coded for coded in done if not coded.by_both]
    return study_tab(
        request,
        study,
        "coding",
        "lab/coding_answer.html",
        status=200 if refused is None else 422,
        who=group,
        question=question,
        codebook=codebook_of(s, study.id, item),
        shown=shown,
        ticked=given if refused is None else refused,
        none_ticked=bool(refused) or (refused is None and shown in changeable and not given),
        refused=refused is not None,
        changeable=changeable,
        count=len(answers),
        done=len(done),
    )


@router.post("/lab/studies/{study_id}/coding/{item}/answers/{response_id}")
def code_answer(
    request: Request,
    study_id: str,
    item: str,
    response_id: str,
    database: Db,
    user: CheckedCsrf,
    codes: Annotated[list[str] | None, Form()] = None,
    none_fits: Annotated[str, Form()] = "",
    who: Annotated[str, Form()] = "",
) -> Response:
    """Give an answer its codes; none at all has to be said, as it is easily clicked past."""
    if bool(codes) == bool(none_fits):
        with database.session() as s:
            return _answer_page(request, s, the_study(s, study_id), item, who, response_id, codes or [])
    with _changing(database, study_id, item) as (s, study):
        coding.code_answer(s, study, item, response_id, codes or [], by=user.name)
    return RedirectResponse(f"/lab/studies/{study_id}/coding/{item}?who={_known(who)}", status_code=303)


@router.get("/lab/studies/{study_id}/coding/{item}/differences")
def differences(request: Request, study_id: str, item: str, database: Db, who: str = "") -> Response:
    """The answers that both have coded, differently, with what each said; what was settled stays on the list."""
    with database.session() as s:
        study = the_study(s, study_id)
        question, group = _question(s, study, item), _group(s, study, who)
        found: list[CodedAnswer] = [coded for coded in coding.answers_to(s, study, item, group) if coded.differs]
        return study_tab(
            request,
            study,
            "coding",
            "lab/coding_differences.html",
            who=group,
            question=question,
            codebook=codebook_of(s, study.id, item),
            found=sorted(found, key=lambda one: not one.open),
        )


@router.post("/lab/studies/{study_id}/coding/{item}/answers/{response_id}/settle")
def settle(
    study_id: str,
    item: str,
    response_id: str,
    database: Db,
    user: CheckedCsrf,
    codes: Annotated[list[str] | None, Form()] = None,
    who: Annotated[str, Form()] = "",
) -> Response:
    with _changing(database, study_id, item) as (s, study):
        coding.settle(s, study, item, response_id, codes or [], by=user.name)
    return RedirectResponse(f"/lab/studies/{study_id}/coding/{item}/differences?who={_known(who)}", status_code=303)


@router.post("/lab/studies/{study_id}/coding/{item}/codes")
def write_code(
    study_id: str,
    item: str,
    database: Db,
    user: CheckedCsrf,
    name: Annotated[str, Form()] = "",
    definition: Annotated[str, Form()] = "",
    who: Annotated[str, Form()] = "",
) -> Response:
    with _changing(database, study_id, item) as (s, study):
        coding.write_code(s, study, item, name, definition, by=user.name)
    return RedirectResponse(f"/lab/studies/{study_id}/coding?who={_known(who)}#{item}", status_code=303)


@router.post("/lab/studies/{study_id}/coding/{item}/codes/{code_id}/remove")
def remove_code(
    study_id: str, item: str, code_id: str, database: Db, user: CheckedCsrf, who: Annotated[str, Form()] = ""
) -> Response:
    with _changing(database, study_id, item) as (s, study):
        coding.remove_code(s, study, item, code_id)
    return RedirectResponse(f"/lab/studies/{study_id}/coding?who={_known(who)}#{item}", status_code=303)


@router.get("/lab/studies/{study_id}/coding/{item}/codings.csv")
def codings_csv(study_id: str, item: str, database: Db) -> Response:
    """All codings of a question as in the data set; the texts stand in its questionnaire_items, by `response`."""
    with database.session() as s:
        study = the_study(s, study_id)
        _question(s, study, item)
        rows = s.execute(
            select(ResponseRow, Participant)
            .join(SessionRow, SessionRow.id == ResponseRow.session_id)
            .join(Participant, Participant.id == SessionRow.participant_id)
            .where(SessionRow.study_id == study.id, ResponseRow.kind == "questionnaire", not_left_out())
            .order_by(Participant.code, ResponseRow.created_at, ResponseRow.id)
        ).all()
        people = {answer.session_id: person for answer, person in rows}

        def marks(session_id: str) -> dict[str, object]:
            person = people[session_id]
            return {
                "session": session_id,
                "participant": person.code,
                "simulated": person.simulated,
                "excluded": left_out_of_study(person) == "excluded",
            }

        header = [column.name for column in CODINGS.columns]
        found = coding_rows(s, study, [answer for answer, _ in rows], marks, item)
        table = [[row[name] for name in header] for row in found]
    return csv_response(header, table, f"codings-{item}.csv")


def _known(who: str) -> str:
    return who if who in GROUPS else ""
