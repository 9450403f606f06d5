"""The settings page: where participants reach this installation, whom they ask for help, who may sign in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated
from urllib.parse import urlsplit

from fastapi import APIRouter, Depends, Form, Request
from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import RedirectResponse, Response

from desirepath.store.events import log_event
from desirepath.store.models import (
    Identity,
    Invitation,
    SecondFactor,
    Setting,
    SignIn,
    SignInUnderWay,
    Study,
    StudyRole,
    User,
)
from desirepath.web.core import second_factor
from desirepath.web.core.admission_by_openid import INVITED_ROLES
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import (
    AccountError,
    CheckedCsrf,
    add_user,
    check_csrf,
    check_owner_left,
    reset_password,
    set_role,
)
from desirepath.web.core.dependencies import Db, contact, public_url
from desirepath.web.core.lab_frame import LabRefusal, lab_page
from desirepath.web.core.roles import ROLES
from desirepath.web.core.sign_ins import end_all

LONGEST_CONTACT = 300

router = APIRouter(dependencies=[Depends(check_csrf)], tags=["settings"])


@dataclass(frozen=True)
class NewPassword:
    """A password that is shown once, to hand over."""

    name: str
    password: str


def check_public_url(text: str) -> str:
    """The address without a trailing slash; empty stays empty. Raises ValueError unless it is http(s)://HOST[:PORT]."""
    text = text.strip().rstrip("/")
    if not text:
        return ""
    parts = urlsplit(text)
    plain = not (parts.path or parts.query or parts.fragment or parts.username or parts.password)
    if parts.scheme not in ("http", "https") or not parts.hostname or not plain or any(c in text for c in " \\<>\"'"):
        raise ValueError(text)
    _ = parts.port  # raises ValueError for a port that is no number up to 65535
    return text


@router.get("/lab/settings")
def settings(request: Request, database: Db) -> Response:
    return settings_page(request, database)


@router.post("/lab/settings")
def save_settings(
    request: Request,
    database: Db,
    user: CheckedCsrf,
    address: Annotated[str, Form()] = "",
    help_contact: Annotated[str, Form()] = "",
) -> Response:
    """Empty fields go back to what the server was started with."""
    try:
        checked = check_public_url(address)
    except ValueError:
        return settings_page(request, database, status=422, problem="address", address=address)
    if checked and request.state.sign_in.by_link:
        raise LabRefusal(422, "password_first")
    contact_line = " ".join(help_contact.split())[:LONGEST_CONTACT]
    with database.transaction() as s:
        before = {"public_url": _stored(s, "public_url", "url"), "contact": _stored(s, "contact", "text")}
        _put(s, "public_url", "url", checked)
        _put(s, "contact", "text", contact_line)
        after = {"public_url": checked, "contact": contact_line}
        changed = {name: {"before": before[name], "after": now} for name, now in after.items() if before[name] != now}
        log_event(s, "settings_changed", by=user.name)
    audit_details(request, **changed)
    return RedirectResponse("/lab/settings?done=settings_saved", status_code=303)


@router.post("/lab/settings/accounts")
def add_account(
    request: Request,
    database: Db,
    user: CheckedCsrf,
    name: Annotated[str, Form()] = "",
    role: Annotated[str, Form()] = "",
) -> Response:
    try:
        password = add_user(database, name, role)
    except AccountError as problem:
        return settings_page(request, database, status=422, account_problem=problem)
    audit_details(request, name=name.strip().lower(), as_role=role)
    return settings_page(request, database, made=NewPassword(name.strip().lower(), password))


@router.post("/lab/settings/accounts/{name}/role")
def change_role(
    request: Request, name: str, database: Db, user: CheckedCsrf, role: Annotated[str, Form()] = ""
) -> Response:
    """Give a colleague another role. Nobody changes their own, so an owner is always left."""
    if name == user.name:
        raise LabRefusal(422, "own_account")
    try:
        set_role(database, name, role)
    except AccountError as problem:
        return settings_page(request, database, status=422, account_problem=problem)
    audit_details(request, as_role=role)
    return RedirectResponse("/lab/settings?done=role_changed#accounts", status_code=303)


@router.post("/lab/settings/accounts/{name}/reset")
def reset_account(request: Request, name: str, database: Db, user: CheckedCsrf) -> Response:
    """A colleague forgot their password: make a new one, sign them out everywhere."""
    if name == user.name:
        raise LabRefusal(422, "own_account")
    try:
        password = reset_password(database, name)
    except AccountError as problem:
        return settings_page(request, database, status=404, account_problem=problem)
    return settings_page(request, database, made=NewPassword(name, password))


@router.post("/lab/settings/accounts/{name}/sign-out")
def sign_account_out(request: Request, name: str, database: Db, user: CheckedCsrf) -> Response:
    """Sign a colleague out in every browser."""
    with database.transaction() as s:
        ended = end_all(s, _account(s, name).id)
    audit_details(request, ended=ended)
    return RedirectResponse("/lab/settings?done=account_signed_out#accounts", status_code=303)


@router.post("/lab/settings/accounts/{name}/second-factor/remove")
def remove_account_factor(name: str, database: Db, user: CheckedCsrf) -> Response:
    """A colleague has neither their app nor a recovery code: they sign in without from now on. Nobody does so for
    themselves, where a code is asked for."""
    if name == user.name:
        raise LabRefusal(422, "own_account")
    with database.transaction() as s:
        second_factor.remove(s, _account(s, name).id)
    return RedirectResponse("/lab/settings?done=second_factor_removed#accounts", status_code=303)


@router.post("/lab/settings/accounts/{name}/identities/{identity_id}/remove")
def remove_account_identity(name: str, identity_id: str, database: Db, user: CheckedCsrf) -> Response:
    """A colleague comes in by that sign-in elsewhere no more, and is signed out everywhere. It may be their only way
    in: a new password is another."""
    if name == user.name:
        raise LabRefusal(422, "own_account")
    with database.transaction() as s:
        account = _account(s, name)
        found = s.get(Identity, identity_id)
        if found is None or found.user_id != account.id:
            raise LabRefusal(404, "no_identity")
        s.delete(found)
        end_all(s, account.id)
    return RedirectResponse("/lab/settings?done=colleague_identity_removed#accounts", status_code=303)


@router.post("/lab/settings/accounts/{name}/remove")
def remove_account(name: str, database: Db, user: CheckedCsrf) -> Response:
    """Remove a colleague's account. Their name stays in the log, and where they excluded or erased somebody."""
    if name == user.name:
        raise LabRefusal(422, "own_account")
    with database.transaction() as s:
        try:
            check_owner_left(s, name)
        except AccountError:
            raise LabRefusal(422, "last_owner") from None
        found = _account(s, name)
        second_factor.remove(s, found.id)
        s.execute(delete(SignInUnderWay).where(SignInUnderWay.user_id == found.id))
        s.execute(delete(SignIn).where(SignIn.user_id == found.id))
        s.execute(delete(Identity).where(Identity.user_id == found.id))
        s.execute(delete(StudyRole).where(StudyRole.user_id == found.id))
        s.execute(update(Study).where(Study.created_by == found.id).values(created_by=None))
        s.delete(found)
        log_event(s, "account_removed", account=name, by=user.name)
    return RedirectResponse("/lab/settings?done=account_removed", status_code=303)


def _account(s: DatabaseSession, name: str) -> User:
    found = s.scalar(select(User).where(User.name == name))
    if found is None:
        raise LabRefusal(404, "no_account", name=name)
    return found


def _stored(s: DatabaseSession, key: str, field: str) -> str:
    row = s.get(Setting, key)
    return str(row.value.get(field, "")) if row is not None else ""


def _put(s: DatabaseSession, key: str, field: str, value: str) -> None:
    row = s.get(Setting, key)
    if not value:
        if row is not None:
            s.delete(row)
    elif row is None:
        s.add(Setting(key=key, value={field: value}))
    else:
        row.value = {field: value}


def settings_page(request: Request, database: Db, *, status: int = 200, **context: object) -> Response:
    with database.session() as s:
        stored = {key: (row.value if (row := s.get(Setting, key)) else {}) for key in ("public_url", "contact")}
        accounts = list(s.scalars(select(User).order_by(User.name)))
        with_factor = set(s.scalars(select(SecondFactor.user_id).where(SecondFactor.confirmed_at.is_not(None))))
        identities: dict[str, list[Identity]] = {}
        for identity in s.scalars(select(Identity).order_by(Identity.linked_at)):
            identities.setdefault(identity.user_id, []).append(identity)
        invitations = list(s.scalars(select(Invitation).order_by(Invitation.email)))
        given = select(StudyRole, Study.name).join(Study, Study.id == StudyRole.study_id).order_by(Study.name)
        in_studies: dict[str, dict[tuple[str, str], list[str]]] = {}
        for one, study in s.execute(given.order_by(StudyRole.role)):
            in_studies.setdefault(one.user_id, {}).setdefault((one.study_id, study), []).append(one.role)
    shown = {
        "address": stored["public_url"].get("url", ""),
        "help_contact": stored["contact"].get("text", ""),
        "problem": None,
        "account_problem": None,
        "invitation_problem": None,
        "made": None,
    }
    return lab_page(
        request,
        "lab/settings.html",
        status=status,
        used_address=public_url(request),
        used_contact=contact(request),
        accounts=accounts,
        roles=list(ROLES),
        in_studies=in_studies,
        with_factor=with_factor,
        identities=identities,
        invitations=invitations,
        invited_roles=INVITED_ROLES,
        **(shown | context),
    )
