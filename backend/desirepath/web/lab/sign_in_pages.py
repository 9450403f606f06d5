"""Signing in and out: name and password, then the code of a second factor where the account has one.

Who has which account is `core/auth.py`'s, what a signed-in person does with theirs `account_pages.py`'s.
"""

from __future__ import annotations

import secrets
from typing import Annotated, Any

from fastapi import APIRouter, Form, Request
from limits import RateLimitItem, parse
from sqlalchemy import delete, select
from starlette.responses import RedirectResponse, Response

from desirepath.store.audit import record
from desirepath.store.database import Database
from desirepath.store.events import log_event
from desirepath.store.models import SignIn, SignInUnderWay, User
from desirepath.web.core import second_factor
from desirepath.web.core.auditing import audit_details, note_in_audit
from desirepath.web.core.auth import (
    LONGEST_PASSWORD,
    NOBODY,
    CheckedCsrf,
    SignedIn,
    is_served_securely,
    is_signed_in,
    known_hash,
    refuse_foreign_origin,
    renew_hash,
    safe_next,
    verify_password,
)
from desirepath.web.core.dependencies import Db, services_of
from desirepath.web.core.lab_frame import LANGUAGE_COOKIE, LANGUAGES, LabRefusal, lab_page
from desirepath.web.core.opening_link import LINK, PATH, awaits_link, use_token
from desirepath.web.core.sign_ins import (
    COOKIE,
    UNDER_WAY_COOKIE,
    begin_under_way,
    find_device,
    hash_token,
    keep_cookie,
    keep_under_way_cookie,
    know_device,
    open_sign_in,
    under_way,
)
from desirepath.web.core.throttle import network_of, seconds_to_wait, wait_in_words

# All ours. Counted before the password is looked at, so that many at once are no more than one after the other.
ATTEMPTS_PER_NAME_AND_ADDRESS = parse("10 per 5 minutes")
ATTEMPTS_PER_ADDRESS = parse("100 per 5 minutes")  # whole institutes share one
ATTEMPTS_PER_NAME = parse("50 per 1 hour")  # slows guessing from many addresses; known devices have their own count
ATTEMPTS_PER_DEVICE = parse("10 per 5 minutes")
CODES = parse("5 per 5 minutes")  # of an account, or of a device that it knows
CODES_A_DAY = parse("40 per 1 day")  # three codes of a million are right at a time: one guess in 8,000 days of it

router = APIRouter(tags=["accounts"])


@router.get("/lab", include_in_schema=False)
def lab_home(user: SignedIn) -> Response:
    return RedirectResponse("/lab/studies", status_code=303)


@router.get("/lab/language/{code}")
def choose_language(code: str, next: str = "") -> Response:
    """Remember the language of these pages in this browser; open to everybody, like the sign-in page."""
    response = RedirectResponse(safe_next(next), status_code=303)
    if code in LANGUAGES:
        response.set_cookie(LANGUAGE_COOKIE, code, max_age=365 * 86400, httponly=True, samesite="lax", path="/lab")
    return response


@router.get("/lab/sign-in")
def sign_in_page(request: Request, database: Db, next: str = "") -> Response:
    with database.session() as s:
        by_link = awaits_link(s, services_of(request).settings)
    return lab_page(request, "lab/sign_in.html", next=safe_next(next), name="", problem=None, by_link=by_link)


@router.get(PATH)
def sign_in_once(request: Request, database: Db, token: str = "") -> Response:
    """Sign in by the address that the server printed, which opens once; the token leaves the address at once. 403 where
    it is wrong, used, too old, or somebody else than this machine's own browser follows it."""
    refuse_foreign_origin(request)
    if "sec-purpose" in request.headers:  # a browser that looks ahead would use it up
        raise LabRefusal(403, "link")
    if seconds_to_wait(request, [(ATTEMPTS_PER_ADDRESS, f"link address:{network_of(request)}")]) is not None:
        raise LabRefusal(429, "link")
    with database.transaction() as s:
        user = use_token(s, request, token)
        if user is not None:
            s.expunge(user)
    if user is not None:
        return let_in(request, database, user, method=LINK, next="")
    if is_signed_in(request, database):  # the same address once more
        return RedirectResponse("/lab/studies", status_code=303)
    with database.transaction() as s:
        record(s, "sign_in_refused", by=NOBODY, outcome="refused", method=LINK)
    raise LabRefusal(403, "link")


@router.post("/lab/sign-in")
def sign_in(
    request: Request,
    database: Db,
    name: Annotated[str, Form()] = "",
    password: Annotated[str, Form()] = "",
    next: Annotated[str, Form()] = "",
) -> Response:
    """Check name and password; sets the cookie and goes to `next`, or asks for the code of a second factor. 401 when
    wrong, 429 after too many attempts."""
    refuse_foreign_origin(request)
    name = name.strip().lower()[:80]
    with database.session() as s:
        user = s.scalar(select(User).where(User.name == name))
        known = known_hash(user)
        user_id = user.id if user else None
    device = find_device(request, name, known) if user else None
    windows = _windows(request, name, device)

    def again(status: int, problem: str, **values: Any) -> Response:
        return lab_page(
            request,
            "lab/sign_in.html",
            status=status,
            next=safe_next(next),
            name=name,
            problem=problem,
            values=values,
        )

    if (seconds := seconds_to_wait(request, windows)) is not None:
        refused = again(429, "too_many", wait=wait_in_words(seconds))
        refused.headers["Retry-After"] = str(seconds)
        return refused
    if not verify_password(known, password[:LONGEST_PASSWORD]) or user is None or user_id is None:
        with database.transaction() as s:
            log_event(s, "sign_in_refused")
            record(s, "sign_in_refused", by=name if user_id else NOBODY, outcome="refused")
        return again(401, "wrong")
    services_of(request).limiter.clear(*windows[0])
    if (renewed := renew_hash(known, password)) is not None:
        with database.transaction() as s:
            s.get_one(User, user_id).password_hash = renewed
    return let_in(request, database, user, method="password", next=next)


def let_in(request: Request, database: Database, user: User, *, method: str, next: str) -> Response:
    """Go on with somebody whose first factor was right: to the page for the second, or in."""
    with database.session() as s:
        needs_code = second_factor.has_second_factor(s, user.id)
    if not needs_code:
        return _enter(request, database, user, method=method, next=next)
    secret = secrets.token_urlsafe(32)
    with database.transaction() as s:
        begin_under_way(s, secret, "code", {"next": safe_next(next), "method": method}, user.id)
    response = RedirectResponse("/lab/sign-in/code", status_code=303)
    keep_under_way_cookie(response, secret, secure=is_served_securely(request))
    return response


@router.get("/lab/sign-in/code")
def code_page(request: Request, database: Db) -> Response:
    """Asks for the second factor's code; back to the beginning where no sign-in is under way."""
    with database.session() as s:
        if under_way(s, request, "code") is None:
            return RedirectResponse("/lab/sign-in", status_code=303)
    return lab_page(request, "lab/sign_in_code.html", problem=None)


@router.post("/lab/sign-in/code")
def enter_code(request: Request, database: Db, code: Annotated[str, Form()] = "") -> Response:
    """Check the code of the app, or a recovery code; each opens once. 401 when wrong, 429 after too many."""
    refuse_foreign_origin(request)
    with database.session() as s:
        waiting = under_way(s, request, "code")
        user = s.get(User, waiting.user_id) if waiting is not None and waiting.user_id else None
        if waiting is None or user is None:
            return RedirectResponse("/lab/sign-in", status_code=303)
    device = find_device(request, user.name, known_hash(user))
    whose = f"code device:{device}" if device else f"code user:{user.id}"
    if (seconds := seconds_to_wait(request, [(CODES, whose), (CODES_A_DAY, whose)])) is not None:
        values = {"wait": wait_in_words(seconds)}
        refused = lab_page(request, "lab/sign_in_code.html", status=429, problem="too_many", values=values)
        refused.headers["Retry-After"] = str(seconds)
        return refused
    with database.transaction() as s:
        passed = second_factor.use_code(s, user.id, code)
        if passed is None:
            record(s, "code_refused", by=user.name, outcome="refused")
        else:
            s.execute(delete(SignInUnderWay).where(SignInUnderWay.token_hash == waiting.token_hash))
    if passed is None:
        return lab_page(request, "lab/sign_in_code.html", status=401, problem="wrong")
    services_of(request).limiter.clear(CODES, whose)
    method, next = str(waiting.data["method"]), str(waiting.data["next"])
    response = _enter(request, database, user, method=method, next=next, second_factor=passed)
    response.delete_cookie(UNDER_WAY_COOKIE, path="/lab")
    return response


def _enter(request: Request, database: Database, user: User, *, method: str, next: str, **details: str) -> Response:
    """Sign this browser in."""
    note_in_audit(request, "signed_in", by=user.name)
    audit_details(request, method=method, **details)
    with database.transaction() as s:
        token = open_sign_in(s, request, user.id, method)
        known = known_hash(s.get_one(User, user.id))  # which signing in may just have renewed
    response, secure = RedirectResponse(safe_next(next), status_code=303), is_served_securely(request)
    keep_cookie(response, token, secure=secure)
    know_device(response, user.name, known, find_device(request, user.name, known), secure=secure)
    return response


def _windows(request: Request, name: str, device: str | None) -> list[tuple[RateLimitItem, str]]:
    """What an attempt counts towards. On a device that has signed in before, strangers' attempts count for nothing."""
    if device is not None:
        return [(ATTEMPTS_PER_DEVICE, f"device:{device}")]
    network = network_of(request)
    return [
        (ATTEMPTS_PER_NAME_AND_ADDRESS, f"name:{name} address:{network}"),
        (ATTEMPTS_PER_ADDRESS, f"address:{network}"),
        (ATTEMPTS_PER_NAME, f"name:{name}"),
    ]


@router.post("/lab/sign-out")
def sign_out(request: Request, database: Db, user: CheckedCsrf) -> Response:
    with database.transaction() as s:
        s.execute(delete(SignIn).where(SignIn.token_hash == hash_token(request.cookies[COOKIE])))
    response = RedirectResponse("/lab/sign-in", status_code=303)
    response.delete_cookie(COOKIE, path="/", httponly=True, samesite="lax", secure=is_served_securely(request))
    return response
