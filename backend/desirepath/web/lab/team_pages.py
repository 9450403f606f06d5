"""Who works on one study: the roles of accounts in it. Roles of the whole installation are `settings_pages.py`'s."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Depends, Form, Request
from sqlalchemy import delete, select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import RedirectResponse, Response

from desirepath.store.models import StudyRole, User
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import CheckedCsrf, check_csrf
from desirepath.web.core.dependencies import Db
from desirepath.web.core.lab_frame import LabRefusal
from desirepath.web.core.roles import ROLES, STUDY_ROLES, Right
from desirepath.web.lab.study_tabs import study_tab, the_study

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["experimenter"])


@dataclass(frozen=True)
class Colleague:
    """An account with the roles that count in a study: everywhere's and this study's."""

    name: str
    everywhere: str
    here: tuple[str, ...]

    @property
    def sees(self) -> bool:
        """Whether they may look at the study at all."""
        return bool(self.here) or Right.LOOK in ROLES.get(self.everywhere, frozenset())


@router.get("/lab/studies/{study_id}/team")
def team(request: Request, study_id: str, database: Db) -> Response:
    """Everybody who may look at the study; an owner gives roles in it to any account."""
    with database.session() as s:
        study = the_study(s, study_id)
        everyone = _colleagues(s, study.id)
        return study_tab(request, study, "team", everyone=everyone, roles=STUDY_ROLES)


@router.post("/lab/studies/{study_id}/team")
def give_roles(
    request: Request,
    study_id: str,
    database: Db,
    user: CheckedCsrf,
    name: Annotated[str, Form()] = "",
    roles: Annotated[list[str] | None, Form()] = None,
) -> Response:
    """The roles that an account has in this study from now on; none takes them away. Nobody changes their own, so an
    owner is always left."""
    if name == user.name:
        raise LabRefusal(422, "own_account")
    wanted = sorted(set(roles or []))
    unknown = [role for role in wanted if role not in STUDY_ROLES]
    if unknown:
        raise LabRefusal(422, "no_study_role", value=unknown[0][:40], roles=", ".join(STUDY_ROLES))
    with database.transaction() as s:
        study = the_study(s, study_id)
        account = s.scalar(select(User).where(User.name == name).with_for_update())
        if account is None:
            raise LabRefusal(404, "no_account", name=name[:80])
        had = select(StudyRole.role).where(StudyRole.user_id == account.id, StudyRole.study_id == study.id)
        before = sorted(s.scalars(had))
        of_account = delete(StudyRole).where(StudyRole.user_id == account.id, StudyRole.study_id == study.id)
        s.execute(of_account.where(StudyRole.role.not_in(wanted)))
        for one in set(wanted) - set(before):
            s.add(StudyRole(user_id=account.id, study_id=study.id, role=one, given_by=user.name))
    audit_details(request, name=name, before=before, after=wanted)
    return RedirectResponse(f"/lab/studies/{study_id}/team?done=role_changed", status_code=303)


def _colleagues(s: DatabaseSession, study_id: str) -> list[Colleague]:
    here: dict[str, list[str]] = {}
    given = select(StudyRole.user_id, StudyRole.role).where(StudyRole.study_id == study_id)
    for user_id, role in s.execute(given):
        here.setdefault(user_id, []).append(role)
    return [
        Colleague(user.name, user.role, tuple(role for role in STUDY_ROLES if role in here.get(user.id, ())))
        for user in s.scalars(select(User).order_by(User.name))
    ]
