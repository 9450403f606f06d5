"""Coding of open questions: which ones a study asks, who codes what, blind to condition and to each other, what is
settled. Reads and writes the tables; agreement is `analysis/coder_agreement.py`'s, pages are the lab's.

Blind: an answer is handed out as its text alone, in an order of the coder's own that says nothing of when or under
what it was written.
"""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.dataset.coding_rows import codebook_of
from desirepath.store.models import CodebookCode, Coding, Participant, ProtocolVersion, Response, Session, Study
from desirepath.store.who_counts import Group, in_group, not_left_out
from desirepath.study.protocol.freezing import thaw

if TYPE_CHECKING:  # statistics come with it: loaded where somebody asks for an agreement
    from desirepath.analysis.coder_agreement import CoderAgreement

FIRST, SECOND, AGREED = "first", "second", "agreed"
CODERS = (FIRST, SECOND)
LONGEST_NAME, LONGEST_DEFINITION, MOST_CODES = 60, 500, 40


class CodingError(ValueError):
    """It cannot be coded so; `code` says why, for people: key in the pages' words, `values` fill its placeholders."""

    def __init__(self, code: str, **values: object) -> None:
        self.code, self.values = code, values
        super().__init__(f"{code} {values}")


@dataclass(frozen=True)
class OpenQuestion:
    """A question that is answered in the participant's own words. text: by language."""

    item: str
    text: dict[str, str]


@dataclass
class CodedAnswer:
    """One answer's text with the codes that it got so far, by role, and who gave them."""

    response: str
    text: str
    codes: dict[str, frozenset[str]] = field(default_factory=dict)
    coders: dict[str, str] = field(default_factory=dict)

    @property
    def by_both(self) -> bool:
        return FIRST in self.codes and SECOND in self.codes

    @property
    def differs(self) -> bool:
        """Whether both coded it, differently."""
        return self.by_both and self.codes[FIRST] != self.codes[SECOND]

    @property
    def open(self) -> bool:
        """Whether they differ and nothing was settled yet."""
        return self.differs and AGREED not in self.codes

    @property
    def settled(self) -> frozenset[str] | None:
        """What counts: what was agreed on, else what both said; None while there is neither."""
        if AGREED in self.codes:
            return self.codes[AGREED]
        return self.codes[FIRST] if self.by_both and not self.differs else None


def open_questions(s: DatabaseSession, study: Study) -> list[OpenQuestion]:
    """The study's questions with free text, of all its protocol's versions; of a key that is asked twice the first."""
    versions = s.scalars(
        select(ProtocolVersion).where(ProtocolVersion.study_id == study.id).order_by(ProtocolVersion.number)
    )
    questions: dict[str, OpenQuestion] = {}
    for version in (study, *versions):
        for questionnaire in thaw(version).questionnaires.values():
            for item in questionnaire.items:
                if item.type == "text":
                    questions.setdefault(item.key, OpenQuestion(item.key, item.text))
    return list(questions.values())


# ---- answers ---------------------------------------------------------------------------------------------------------


def answers_to(s: DatabaseSession, study: Study, item: str, group: Group) -> list[CodedAnswer]:
    """Everything that was written to a question by those who count, with its codes; in no telling order."""
    rows = s.execute(
        select(Response.id, Response.value)
        .join(Session, Session.id == Response.session_id)
        .join(Participant, Participant.id == Session.participant_id)
        .where(Session.study_id == study.id, Response.kind == "questionnaire", in_group(group), not_left_out())
        .order_by(Response.id)  # random, so it tells nothing
    )
    by_response = {
        id_: CodedAnswer(id_, value[item].strip())
        for id_, value in rows
        if isinstance(value.get(item), str) and value[item].strip()
    }
    for coding in s.scalars(select(Coding).where(Coding.study_id == study.id, Coding.item == item)):
        if coding.response_id in by_response:
            by_response[coding.response_id].codes[coding.role] = frozenset(coding.codes)
            by_response[coding.response_id].coders[coding.role] = coding.coder
    return list(by_response.values())


def coders_of(s: DatabaseSession, study: Study, item: str) -> dict[str, str]:
    """Role -> name of the account that codes this question in it: the first two who began."""
    query = select(Coding.role, Coding.coder).where(
        Coding.study_id == study.id, Coding.item == item, Coding.role.in_(CODERS)
    )
    return {role: coder for role, coder in s.execute(query.distinct())}  # noqa: C416 - rows are no pairs to mypy


def role_for(coders: dict[str, str], name: str) -> str | None:
    """In which role somebody codes, or would; None where two others do."""
    held = [role for role in CODERS if coders.get(role) == name]  # the other one may have become free by an erasure
    free = [role for role in CODERS if role not in coders]
    return next(iter([*held, *free]), None)


def next_for(answers: Iterable[CodedAnswer], role: str, name: str) -> CodedAnswer | None:
    """What this coder has not coded yet, the first in an order of their own."""
    left = [answer for answer in answers if role not in answer.codes]
    return min(
        left, key=lambda candidate: hashlib.sha256(f"{name}\0{candidate.response}".encode()).digest(), default=None
    )


# ---- writing ---------------------------------------------------------------------------------------------------------


def write_code(s: DatabaseSession, study: Study, item: str, name: str, definition: str, *, by: str) -> CodebookCode:
    """A new code. Raises CodingError without a name or definition, for one that is there, for too many."""
    s.get(Study, study.id, with_for_update=True)
    name, definition = " ".join(name.split())[:LONGEST_NAME], definition.strip()[:LONGEST_DEFINITION]
    if not name or not definition:
        raise CodingError("code_incomplete")
    codebook = codebook_of(s, study.id, item)
    if any(code.name.casefold() == name.casefold() for code in codebook):
        raise CodingError("code_twice", name=name)
    if len(codebook) >= MOST_CODES:
        raise CodingError("too_many_codes", most=MOST_CODES)
    code = CodebookCode(study_id=study.id, item=item, name=name, definition=definition, written_by=by)
    s.add(code)
    s.flush()
    return code


def remove_code(s: DatabaseSession, study: Study, item: str, code_id: str) -> None:
    """Take a code out of the codebook. Raises CodingError where there is none, or where it was given to an answer."""
    s.get(Study, study.id, with_for_update=True)  # nobody gives it to an answer meanwhile
    code = s.get(CodebookCode, code_id)
    if code is None or (code.study_id, code.item) != (study.id, item):
        raise CodingError("no_code")
    rows = select(Coding.codes).where(Coding.study_id == study.id, Coding.item == item)
    uses = sum(code_id in codes for codes in s.scalars(rows))
    if uses:
        raise CodingError("code_in_use", name=code.name, count=uses)
    s.delete(code)


def code_answer(
    s: DatabaseSession, study: Study, item: str, response_id: str, codes: Collection[str], *, by: str
) -> Coding:
    """Give an answer its codes, as one of its two coders; again until the other one did.

    Raises CodingError where two others code this question, for an answer or a code that is not there, and where both
    have coded it: what they said then stays as it was said, for the sake of their agreement.
    """
    s.get(Study, study.id, with_for_update=True)  # who is first and who second is decided one at a time
    role = role_for(coders_of(s, study, item), by)
    if role is None:
        raise CodingError("two_others_code")
    _check(s, study, item, response_id, codes)
    theirs = _coding(s, response_id, item, role)
    other = _coding(s, response_id, item, SECOND if role == FIRST else FIRST)
    if theirs is not None and other is not None:
        raise CodingError("both_coded")
    return _write(s, study, item, response_id, role, codes, theirs, by=by)


def settle(s: DatabaseSession, study: Study, item: str, response_id: str, codes: Collection[str], *, by: str) -> Coding:
    """What is agreed on where both differ; what each said is kept beside it. Raises CodingError where they do not."""
    s.get(Study, study.id, with_for_update=True)
    _check(s, study, item, response_id, codes)
    first, second = (_coding(s, response_id, item, role) for role in CODERS)
    if first is None or second is None or set(first.codes) == set(second.codes):
        raise CodingError("nothing_to_settle")
    return _write(s, study, item, response_id, AGREED, codes, _coding(s, response_id, item, AGREED), by=by)


def _check(s: DatabaseSession, study: Study, item: str, response_id: str, codes: Collection[str]) -> None:
    rows = (
        select(Response.value)
        .join(Session, Session.id == Response.session_id)
        .join(Participant, Participant.id == Session.participant_id)
        .where(Response.id == response_id, Session.study_id == study.id, not_left_out())
    )
    value = s.scalar(rows)
    if value is None or not isinstance(value.get(item), str):
        raise CodingError("no_answer")
    if set(codes) - {code.id for code in codebook_of(s, study.id, item)}:
        raise CodingError("no_code")


def _coding(s: DatabaseSession, response_id: str, item: str, role: str) -> Coding | None:
    rows = select(Coding).where(Coding.response_id == response_id, Coding.item == item, Coding.role == role)
    return s.scalars(rows).first()


def _write(
    s: DatabaseSession,
    study: Study,
    item: str,
    response_id: str,
    role: str,
    codes: Collection[str],
    coded: Coding | None,
    *,
    by: str,
) -> Coding:
    coding = coded or Coding(study_id=study.id, response_id=response_id, item=item, role=role)
    coding.coder, coding.codes = by, sorted(set(codes))
    s.add(coding)
    s.flush()
    return coding


# ---- what came of it -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class QuestionCoded:
    """How far a question is coded and what was found. counts: code's id -> answers that have it, of `settled` ones;
    agreement: by code's id, over answers that both coded, as each coded them; pooled: over all codes."""

    question: OpenQuestion
    codebook: list[CodebookCode]
    answers: int
    coders: dict[str, str]
    coded: dict[str, int]
    by_both: int
    open: int
    settled: int
    counts: dict[str, int]
    agreement: dict[str, CoderAgreement]
    pooled: CoderAgreement | None


def summarise_question(s: DatabaseSession, study: Study, question: OpenQuestion, group: Group) -> QuestionCoded:
    """Everything that the lab's page says of one question."""
    from desirepath.analysis.coder_agreement import agreement_on, agreement_on_all

    answers = answers_to(s, study, question.item, group)
    codebook = codebook_of(s, study.id, question.item)
    both = [answer for answer in answers if answer.by_both]
    first, second = ([answer.codes[role] for answer in both] for role in CODERS)
    ids = [code.id for code in codebook]
    settled = [answer.settled for answer in answers if answer.settled is not None]
    coded: dict[str, int] = defaultdict(int)
    coded.update(Counter(role for answer in answers for role in answer.codes))
    return QuestionCoded(
        question=question,
        codebook=codebook,
        answers=len(answers),
        coders=coders_of(s, study, question.item),
        coded=coded,
        by_both=len(both),
        open=sum(answer.open for answer in answers),
        settled=len(settled),
        counts=dict(Counter(code for codes in settled for code in codes)),
        agreement={code: agreement_on(code, first, second) for code in ids} if both else {},
        pooled=agreement_on_all(ids, first, second) if both and ids else None,
    )
