"""Signing in by the OpenID provider, and linking one's account with somebody there.

What the provider's answer is worth is `core/openid.py`'s, whose account that is `core/admission_by_openid.py`'s.
"""

from __future__ import annotations

import hmac
import secrets
from typing import Annotated

import structlog
from fastapi import APIRouter, Depends, Form, Request
from limits import parse
from sqlalchemy import delete, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import RedirectResponse, Response

from desirepath.store.audit import record
from desirepath.store.database import Database
from desirepath.store.events import log_event
from desirepath.store.models import Identity, Invitation, SignInUnderWay, User
from desirepath.web.core.admission_by_openid import account_of, invite, link, new_account
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import (
    NOBODY,
    AccountError,
    CheckedCsrf,
    NotSignedIn,
    PasswordMustChange,
    SecondFactorMissing,
    check_csrf,
    is_served_securely,
    require_sign_in,
    safe_next,
    verify_password,
)
from desirepath.web.core.dependencies import Db, public_url, services_of
from desirepath.web.core.lab_frame import LabRefusal, lab_page
from desirepath.web.core.openid import OpenId, OpenIdError, Someone
from desirepath.web.core.sign_ins import begin_under_way, keep_under_way_cookie, under_way
from desirepath.web.core.throttle import count, network_of
from desirepath.web.lab.account_pages import Counted
from desirepath.web.lab.settings_pages import settings_page
from desirepath.web.lab.sign_in_pages import let_in

RETURN = "/lab/sign-in/openid/return"
BEGUN_PER_ADDRESS = parse("60 per 5 minutes")  # ours; each leaves a row for ten minutes
log = structlog.get_logger("desirepath.web")
router = APIRouter(tags=["accounts"])
behind = APIRouter(dependencies=[Depends(check_csrf)], tags=["accounts"])


@router.get("/lab/sign-in/openid")
def begin(request: Request, database: Db, next: str = "") -> Response:
    """Send the browser to the provider."""
    return _sent_there(request, database, {"next": safe_next(next)})


@behind.get("/lab/account/identity/begin")
def begin_linking(request: Request, database: Db, user: CheckedCsrf) -> Response:
    """The same for who is signed in and wants to be let in that way from now on; it is asked once more after."""
    return _sent_there(request, database, {"next": "/lab/account"}, user.id)


@router.get(RETURN)
def come_back(
    request: Request, database: Db, state: str = "", code: str = "", iss: str | None = None, error: str = ""
) -> Response:
    """Where the provider sends the browser. Each answer is taken once, and only by the browser that asked."""
    openid = _provider(request)
    with database.transaction() as s:
        begun = under_way(s, request, "openid")
        expected = str(begun.data["state"]) if begun is not None else ""
        if begun is None or not hmac.compare_digest(expected.encode(), state.encode()):
            return _again(request, "stale", 400)
        known, linking = dict(begun.data), begun.user_id
        s.delete(begun)
    try:
        if error or not code:
            raise OpenIdError("cancelled" if error == "access_denied" else "failed", f"it answered {error[:60]!r}")
        found = openid.someone(code, known["redirect"], nonce=known["nonce"], verifier=known["verifier"], issuer=iss)
    except OpenIdError as problem:
        log.warning("a sign-in by OpenID failed", problem=str(problem)[:300])
        return _again(request, problem.code, 503 if problem.code == "away" else 401)
    if linking is not None:
        return _asked_to_link(request, database, linking, found)
    user = _account(request, database, found)
    if user is None:
        with database.transaction() as s:
            log_event(s, "sign_in_refused")
            record(s, "sign_in_refused", by=NOBODY, outcome="refused", method="openid")
        return _again(request, "not_admitted" if found.email_verified else "not_verified", 403)
    return let_in(request, database, user, method="openid", next=known["next"])


@behind.get("/lab/account/identity")
def linking_page(request: Request, database: Db, user: CheckedCsrf) -> Response:
    """Asks whether this is who shall open the account from now on."""
    with database.session() as s:
        found = _waiting(s, request, user)
        if found is None:
            return RedirectResponse("/lab/account", status_code=303)
        return _linking_page(request, user, found)


@behind.post("/lab/account/identity/link", dependencies=[Counted])
def link_identity(request: Request, database: Db, user: CheckedCsrf, password: Annotated[str, Form()] = "") -> Response:
    """Link what the browser brought back. Needs the password where there is one: a browser left open shall not become
    a way in that stays. What opens another account already is refused."""
    proven = not user.password_hash or verify_password(user.password_hash, password)
    with database.transaction() as s:
        found = _waiting(s, request, user)
        if found is None:
            raise LabRefusal(422, "no_identity")
        if not proven:
            return _linking_page(request, user, found, status=422, problem="password")
        known = found.data
        someone = Someone(known["issuer"], known["subject"], known["email"], False, "")
        if account_of(s, someone) is not None:
            raise LabRefusal(422, "identity_taken")
        link(s, user.id, someone)
        s.delete(found)
    return RedirectResponse("/lab/account?done=identity_linked", status_code=303)


@behind.post("/lab/account/identity/{identity_id}/remove")
def remove_identity(identity_id: str, database: Db, user: CheckedCsrf) -> Response:
    """Take a link away, unless it is the only way in."""
    with database.transaction() as s:
        mine = list(s.scalars(select(Identity).where(Identity.user_id == user.id)))
        found = next((identity for identity in mine if identity.id == identity_id), None)
        if found is None:
            raise LabRefusal(404, "no_identity")
        if not user.password_hash and len(mine) == 1:
            raise LabRefusal(422, "last_way_in")
        s.delete(found)
    return RedirectResponse("/lab/account?done=identity_removed", status_code=303)


@behind.post("/lab/settings/invitations")
def add_invitation(
    request: Request,
    database: Db,
    user: CheckedCsrf,
    email: Annotated[str, Form()] = "",
    role: Annotated[str, Form()] = "",
) -> Response:
    """Let somebody in by their address at the provider; any role but owner."""
    _provider(request)
    try:
        with database.transaction() as s:
            made = invite(s, email, role, user.name).id
    except AccountError as problem:
        return settings_page(request, database, status=422, invitation_problem=problem)
    audit_details(request, invitation_id=made, as_role=role)
    return RedirectResponse("/lab/settings?done=invited#invitations", status_code=303)


@behind.post("/lab/settings/invitations/{invitation_id}/withdraw")
def withdraw_invitation(invitation_id: str, database: Db, user: CheckedCsrf) -> Response:
    with database.transaction() as s:
        s.execute(delete(Invitation).where(Invitation.id == invitation_id))
    return RedirectResponse("/lab/settings?done=invitation_withdrawn#invitations", status_code=303)


def _provider(request: Request) -> OpenId:
    openid = services_of(request).openid
    if openid is None:
        raise LabRefusal(404, "no_openid")
    return openid


def _sent_there(request: Request, database: Database, data: dict[str, str], user_id: str | None = None) -> Response:
    openid = _provider(request)
    if not count(request, BEGUN_PER_ADDRESS, f"openid address:{network_of(request)}"):
        return _again(request, "too_many", 429)
    secret, redirect = secrets.token_urlsafe(32), public_url(request) + RETURN
    asked = {"state": secrets.token_urlsafe(32), "nonce": secrets.token_urlsafe(32)}
    asked["verifier"] = secrets.token_urlsafe(48)
    try:
        address = openid.address(redirect, **asked)
    except OpenIdError as problem:
        log.error("the OpenID provider cannot be used", problem=str(problem)[:300])
        return _again(request, problem.code, 503)
    with database.transaction() as s:
        begin_under_way(s, secret, "openid", {**data, **asked, "redirect": redirect}, user_id)
    response = RedirectResponse(address, status_code=303)
    keep_under_way_cookie(response, secret, secure=is_served_securely(request))
    return response


def _account(request: Request, database: Database, found: Someone) -> User | None:
    """The account that is theirs, made where they may have one; two first visits at once make one."""
    allowed = services_of(request).settings.openid_allowed
    for _ in range(2):
        try:
            with database.transaction() as s:
                user = account_of(s, found)
                if user is None:
                    user = new_account(s, found, allowed)
                    if user is not None:
                        record(s, "account_added", by=user.name, role=user.role, name=user.name, method="openid")
                s.flush()
                if user is not None:
                    s.expunge(user)
            return user
        except IntegrityError:
            continue
    return None


def _asked_to_link(request: Request, database: Database, user_id: str, found: Someone) -> Response:
    """Keep whom the provider named until the signed-in person says yes."""
    try:
        user = require_sign_in(request, database)
    except (NotSignedIn, PasswordMustChange, SecondFactorMissing):
        return _again(request, "stale", 400)
    if user.id != user_id:
        return _again(request, "stale", 400)
    secret = secrets.token_urlsafe(32)
    claimed = {"issuer": found.issuer, "subject": found.subject, "email": found.email}
    with database.transaction() as s:
        begin_under_way(s, secret, "link", claimed, user_id)
    response = RedirectResponse("/lab/account/identity", status_code=303)
    keep_under_way_cookie(response, secret, secure=is_served_securely(request))
    return response


def _linking_page(
    request: Request, user: User, found: SignInUnderWay, *, status: int = 200, problem: str | None = None
) -> Response:
    return lab_page(
        request,
        "lab/link_identity.html",
        status=status,
        email=found.data["email"],
        issuer=found.data["issuer"],
        has_password=bool(user.password_hash),
        problem=problem,
    )


def _waiting(s: DatabaseSession, request: Request, user: User) -> SignInUnderWay | None:
    found = under_way(s, request, "link")
    return found if found is not None and found.user_id == user.id else None


def _again(request: Request, problem: str, status: int) -> Response:
    """The sign-in page with what went wrong."""
    return lab_page(
        request, "lab/sign_in.html", status=status, next="/lab/studies", name="", problem=None, openid_problem=problem
    )
