"""Codebook and coded answers on their way into a data set and back. What they are stands in `models/coding.py`.

A coder is "first" or "second" there: no account's name is in a data set.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from desirepath.store.models import CodebookCode, Coding, Response, Study

Row = dict[str, Any]
IMPORTED = "imported"  # as the writer of codes and the coder of answers that came with a data set
ROLES = ("first", "second", "agreed")


def codebook_of(s: Session, study_id: str, item: str | None = None) -> list[CodebookCode]:
    """The codes of a study's questions, or of one, in the order in which they were written."""
    query = select(CodebookCode).where(CodebookCode.study_id == study_id)
    if item is not None:
        query = query.where(CodebookCode.item == item)
    return list(s.scalars(query.order_by(CodebookCode.item, CodebookCode.created_at, CodebookCode.id)))


def code_rows(s: Session, study: Study) -> Iterator[Row]:
    for code in codebook_of(s, study.id):
        yield {"item": code.item, "code": code.name, "definition": code.definition, "created_at": code.created_at}


def coding_rows(
    s: Session, study: Study, answers: Iterable[Response], marks: Callable[[str], Row], item: str | None = None
) -> Iterator[Row]:
    """The codings of these answers, in their order; one row per code, one without a code where none fits. item: of this
    question alone."""
    names = {code.id: code.name for code in codebook_of(s, study.id)}
    codings: dict[str, list[Coding]] = defaultdict(list)
    for coding in s.scalars(select(Coding).where(Coding.study_id == study.id)):
        if item is None or coding.item == item:
            codings[coding.response_id].append(coding)
    for answer in answers:
        for coding in sorted(codings[answer.id], key=lambda coding: (coding.item, ROLES.index(coding.role))):
            named: list[str | None] = [*sorted(names[code] for code in coding.codes)]
            for code in named or [None]:
                yield {
                    "response": answer.id,
                    **marks(answer.session_id),
                    "item": coding.item,
                    "coder": coding.role,
                    "code": code,
                    "coded_at": coding.created_at,
                }


def add_codings(s: Session, study_id: str, codebook: Iterable[Row], codings: Iterable[Row]) -> None:
    """Write the rows of a data set into the tables. Raises KeyError where a coding names an unknown code."""
    ids: dict[tuple[str, str], str] = {}
    for row in codebook:
        code = CodebookCode(
            study_id=study_id,
            item=row["item"],
            name=row["code"],
            definition=row["definition"],
            written_by=IMPORTED,
            created_at=row["created_at"],
        )
        s.add(code)
        s.flush()  # one by one: codes of one moment keep an order
        ids[row["item"], row["code"]] = code.id
    by_coder: dict[tuple[str, str, str], list[Row]] = defaultdict(list)
    for row in codings:
        by_coder[row["response"], row["item"], row["coder"]].append(row)
    for (response, item, role), rows in by_coder.items():
        s.add(
            Coding(
                study_id=study_id,
                response_id=response,
                item=item,
                role=role,
                coder=f"{IMPORTED} {role}",
                codes=[ids[item, row["code"]] for row in rows if row["code"] is not None],
                created_at=rows[0]["coded_at"],
            )
        )
