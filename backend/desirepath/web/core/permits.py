"""Which study a request is about, and what of a list somebody may see. What each role may do stands in `roles.py`.

What was made from one study's answers belongs to that study, however many steps lie between; what was made from
several studies is for those who may look at all of them. What belongs to none is shared by the installation.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sqlalchemy import ColumnElement, Text, and_, cast, exists, false, or_, select, true
from sqlalchemy.orm import InstrumentedAttribute
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.database import Database
from desirepath.store.models import Artefact, ArtefactParent, Job
from desirepath.web.core.roles import SHARED, Right, Rights


def allows(database: Database, rights: Rights, right: Right, path: Mapping[str, Any]) -> bool:
    """Whether a request for a route that needs `right` may go on; `path`: the parameters in its address.

    What an address names and is not there is as what belongs to no study.
    """
    if "study_id" in path:
        return rights.may(right, path["study_id"])
    with database.session() as s:
        if (artefact := s.get(Artefact, path.get("artefact_id", ""))) is not None:
            return may_with(s, rights, right, artefact)
        if (job := s.get(Job, path.get("job_id", ""))) is not None:
            return rights.may(right, job.study_id) and _found(s, Job.id, job.id, seen_jobs(rights))
    return rights.may(right)


def may_with(s: DatabaseSession, rights: Rights, right: Right, artefact: Artefact) -> bool:
    """Whether something may be done with an artefact."""
    if right in rights.everywhere:
        return True
    return rights.may(right, artefact.study_id) and _found(s, Artefact.id, artefact.id, seen_artefacts(rights, right))


def in_studies(
    rights: Rights, column: InstrumentedAttribute[str] | InstrumentedAttribute[str | None], right: Right = Right.LOOK
) -> ColumnElement[bool]:
    """A condition: the study in this column is one in which that may be done; rows of no study are shared."""
    studies = rights.studies(right)
    if studies is None:
        return true()
    return or_(column.in_(studies), column.is_(None) if right in SHARED and studies else false())


def seen_artefacts(rights: Rights, right: Right = Right.LOOK) -> ColumnElement[bool]:
    """A condition on `Artefact`: made from answers of such studies only, in which that may be done.

    To tidy an artefact up does nothing to what it was made from, which it is enough to be shown.
    """
    if rights.studies(right) is None:
        return true()
    before = rights.studies(right if right in SHARED else Right.LOOK)
    of_those = Artefact.id.not_in(_foreign(before)) if before is not None else true()
    return and_(in_studies(rights, Artefact.study_id, right), of_those)


def seen_jobs(rights: Rights) -> ColumnElement[bool]:
    """A condition on `Job`: of such studies, and nothing that it works on or made is of others."""
    studies = rights.studies(Right.LOOK)
    if studies is None:
        return true()
    made = select(Artefact.job_id).where(Artefact.job_id.is_not(None), Artefact.id.in_(_foreign(studies)))
    named = exists().where(Artefact.id.in_(_foreign(studies)), cast(Job.params, Text).contains(Artefact.id))
    return and_(in_studies(rights, Job.study_id), Job.id.not_in(made), ~named)


def _foreign(studies: frozenset[str]) -> Any:
    """Ids of all that was made from answers of other studies."""
    foreign = select(Artefact.id).where(Artefact.study_id.is_not(None), Artefact.study_id.not_in(studies))
    found = foreign.cte(recursive=True)
    made = select(ArtefactParent.artefact_id).join(found, ArtefactParent.parent_id == found.c.id)
    return select(found.union(made).c.id)


def _found(s: DatabaseSession, column: InstrumentedAttribute[str], value: str, where: ColumnElement[bool]) -> bool:
    return s.scalar(select(column).where(column == value, where)) is not None
