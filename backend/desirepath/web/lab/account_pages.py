"""One's own account: password, signed-in browsers, second factor. Other people's accounts are `settings_pages.py`'s."""

from __future__ import annotations

from typing import Annotated
from urllib.parse import urlsplit

from fastapi import APIRouter, Depends, Form, Request
from limits import parse
from markupsafe import Markup
from sqlalchemy import select
from starlette.responses import RedirectResponse, Response

from desirepath.store.database import Database
from desirepath.store.models import Identity, User
from desirepath.web.core import second_factor
from desirepath.web.core.auditing import audit_details
from desirepath.web.core.auth import (
    SECOND_FACTOR,
    SHORTEST_PASSWORD,
    AccountError,
    CheckedCsrf,
    change_password,
    verify_password,
)
from desirepath.web.core.dependencies import Db, public_url
from desirepath.web.core.lab_frame import LabRefusal, lab_page
from desirepath.web.core.sign_ins import COOKIE, end_all, end_one, hash_token, list_sign_ins
from desirepath.web.core.throttle import seconds_to_wait, wait_in_words

PROOFS = parse("10 per 5 minutes")  # ours: passwords and codes that a signed-in browser types in here
PROOFS_A_DAY = parse("60 per 1 day")  # ours; without it a stolen sign-in guesses a code of the app in some hundred days
router = APIRouter(tags=["accounts"])


def count_proof(request: Request, user: CheckedCsrf) -> None:
    """Count a password or code that a signed-in browser types in; refused where it is one too many."""
    whose = f"proof user:{user.id}"
    seconds = seconds_to_wait(request, [(PROOFS, whose), (PROOFS_A_DAY, whose)])
    if seconds is not None:
        raise LabRefusal(429, "too_many_proofs", wait=wait_in_words(seconds))


Counted = Depends(count_proof)


@router.get("/lab/password")
def password_page(request: Request, user: CheckedCsrf) -> Response:
    return lab_page(request, "lab/password.html", problem=None, shortest=SHORTEST_PASSWORD)


@router.post("/lab/password", dependencies=[Counted])
def change_own_password(
    request: Request,
    database: Db,
    user: CheckedCsrf,
    current: Annotated[str, Form()] = "",
    new: Annotated[str, Form()] = "",
    again: Annotated[str, Form()] = "",
) -> Response:
    try:
        if new != again:
            raise AccountError("password_differs")
        by_link = request.state.sign_in.by_link
        change_password(database, user.id, current, new, keep=hash_token(request.cookies[COOKIE]), by_link=by_link)
    except AccountError as problem:
        return lab_page(request, "lab/password.html", status=422, problem=problem, shortest=SHORTEST_PASSWORD)
    return RedirectResponse("/lab/studies?done=password_changed", status_code=303)


@router.get("/lab/account")
def account(request: Request, database: Db, user: CheckedCsrf) -> Response:
    """Everything about one's own account on one page."""
    return _account_page(request, database, user)


@router.post("/lab/account/sign-ins/{sign_in_id}/end")
def end_sign_in(sign_in_id: str, database: Db, user: CheckedCsrf) -> Response:
    """Sign one browser out; one that is out already stays so."""
    with database.transaction() as s:
        if not end_one(s, user.id, sign_in_id):
            raise LabRefusal(404, "no_sign_in")
    return RedirectResponse("/lab/account?done=sign_in_ended", status_code=303)


@router.post("/lab/account/sign-ins-elsewhere/end")
def end_other_sign_ins(request: Request, database: Db, user: CheckedCsrf) -> Response:
    """Sign every other browser out."""
    with database.transaction() as s:
        ended = end_all(s, user.id, but=hash_token(request.cookies[COOKIE]))
    audit_details(request, ended=ended)
    return RedirectResponse("/lab/account?done=sign_ins_ended", status_code=303)


@router.get(SECOND_FACTOR)
def second_factor_page(request: Request, database: Db, user: CheckedCsrf) -> Response:
    """The way to a second factor, or what the one that is there allows."""
    return _second_factor_page(request, database, user)


@router.post(SECOND_FACTOR + "/begin", dependencies=[Counted])
def begin_second_factor(
    request: Request, database: Db, user: CheckedCsrf, password: Annotated[str, Form()] = ""
) -> Response:
    """Make a secret for the app. Needs the password where there is one: a browser left open is not enough."""
    if user.password_hash and not verify_password(user.password_hash, password):
        return _second_factor_page(request, database, user, status=422, problem="password")
    with database.transaction() as s:
        if second_factor.has_second_factor(s, user.id):
            raise LabRefusal(422, "second_factor_there")
        second_factor.begin(s, user.id)
    return RedirectResponse(SECOND_FACTOR, status_code=303)


@router.post(SECOND_FACTOR + "/confirm", dependencies=[Counted])
def confirm_second_factor(
    request: Request, database: Db, user: CheckedCsrf, code: Annotated[str, Form()] = ""
) -> Response:
    """With the app's first code it counts; other browsers are signed out, recovery codes are shown once."""
    with database.transaction() as s:
        codes = second_factor.confirm(s, user.id, code)
        if codes is not None:
            end_all(s, user.id, but=hash_token(request.cookies[COOKIE]))
    if codes is None:
        return _second_factor_page(request, database, user, status=422, problem="code")
    return _second_factor_page(request, database, user, codes=codes)


@router.post(SECOND_FACTOR + "/codes", dependencies=[Counted])
def renew_recovery_codes(
    request: Request, database: Db, user: CheckedCsrf, code: Annotated[str, Form()] = ""
) -> Response:
    """New recovery codes for a code; the ones before stop."""
    with database.transaction() as s:
        codes = second_factor.new_recovery_codes(s, user.id) if second_factor.use_code(s, user.id, code) else None
    if codes is None:
        return _second_factor_page(request, database, user, status=422, problem="code")
    return _second_factor_page(request, database, user, codes=codes)


@router.post(SECOND_FACTOR + "/remove", dependencies=[Counted])
def remove_second_factor(
    request: Request, database: Db, user: CheckedCsrf, code: Annotated[str, Form()] = ""
) -> Response:
    """Sign in without one from now on; needs a code of it, or a recovery code."""
    with database.transaction() as s:
        passed = second_factor.use_code(s, user.id, code)
        if passed is not None:
            second_factor.remove(s, user.id)
    if passed is None:
        return _second_factor_page(request, database, user, status=422, problem="code")
    return RedirectResponse("/lab/account?done=second_factor_removed", status_code=303)


def _account_page(request: Request, database: Database, user: User) -> Response:
    with database.session() as s:
        linked = list(s.scalars(select(Identity).where(Identity.user_id == user.id).order_by(Identity.linked_at)))
        factor, left = second_factor.has_second_factor(s, user.id), second_factor.recovery_codes_left(s, user.id)
    return lab_page(
        request,
        "lab/account.html",
        sign_ins=list_sign_ins(database, user.id, request.cookies[COOKIE]),
        has_factor=factor,
        codes_left=left,
        has_password=bool(user.password_hash),
        linked=linked,
    )


def _second_factor_page(
    request: Request,
    database: Database,
    user: User,
    *,
    status: int = 200,
    problem: str | None = None,
    codes: list[str] | None = None,
) -> Response:
    """codes: recovery codes to show this once."""
    with database.session() as s:
        factor, waiting = second_factor.has_second_factor(s, user.id), second_factor.pending_secret(s, user.id)
        left = second_factor.recovery_codes_left(s, user.id)
    drawn = ""
    if waiting is not None:
        where = urlsplit(public_url(request)).hostname or "localhost"
        drawn = Markup(second_factor.picture(waiting, user.name, where))  # noqa: S704  drawn here of our own letters
    return lab_page(
        request,
        "lab/second_factor.html",
        status=status,
        problem=problem,
        has_factor=factor,
        secret=waiting,
        picture=drawn,
        codes=codes,
        codes_left=left,
        has_password=bool(user.password_hash),
    )
