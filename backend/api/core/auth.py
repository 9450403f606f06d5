"""Who may use the signed-in pages: accounts, sign-in, cookies, CSRF. What those pages show lives elsewhere.

A signed-in browser holds a random token in an HttpOnly cookie; the database holds its sha256 only. Every signed-in
page takes `SignedIn`; every router of such pages is made with `dependencies=[Depends(checked_csrf)]`, which also holds
the roles (`roles.py`) and the audit log (`auditing.py`).
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from datetime import timedelta
from functools import cache
from typing import Annotated, Any
from urllib.parse import quote, urlsplit

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError
from fastapi import APIRouter, Depends, Form, Request
from limits import RateLimitItem, parse
from sqlalchemy import delete, select
from sqlalchemy.orm import Session as DatabaseSession
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, RedirectResponse, Response

from backend.api.core.addresses import public_url
from backend.api.core.auditing import audited
from backend.api.core.dependencies import Db, route_of, services_of
from backend.api.core.lab_frame import LANGUAGE_COOKIE, LANGUAGES, LabRefusal, SignInState, lab_page, lab_refusal
from backend.api.core.permits import allows
from backend.api.core.roles import ROLES, rights_of, rule_of
from backend.api.core.throttle import address_of, count
from backend.store.audit import record
from backend.store.database import Database
from backend.store.events import log_event
from backend.store.models import SignIn, StudyRole, User, utc_now

COOKIE = "desirepath_sign_in"
FIRST_USER = "experimenter"
NOBODY = "-"  # in the audit log, for a name that is none: it may be a password typed into the wrong field
SIGN_IN_LASTS = timedelta(hours=12)  # (ours) one working day; the browser keeps the cookie no longer either
SHORTEST_PASSWORD = 12  # characters (ours); NIST SP 800-63B asks for length, not for mixtures
LONGEST_PASSWORD = 200  # hashing has a cost; nobody types more
USER_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{1,39}")
DEVICE_COOKIE = "desirepath_known_device"
DEVICE_LASTS = timedelta(days=365)
# All ours. Counted before the password is looked at, so that many at once are no more than one after the other.
ATTEMPTS_PER_NAME_AND_ADDRESS = parse("10 per 5 minutes")
ATTEMPTS_PER_ADDRESS = parse("100 per 5 minutes")  # whole institutes share one
ATTEMPTS_PER_NAME = parse("50 per 1 hour")  # slows guessing from many addresses; known devices have their own count
ATTEMPTS_PER_DEVICE = parse("10 per 5 minutes")

_hasher = PasswordHasher()  # argon2id; RFC 9106 low-memory profile is the library's default


@cache
def _nobody() -> str:
    """Hashed once per process, verified when the name is unknown: unknown names take as long as wrong passwords."""
    return _hasher.hash(secrets.token_urlsafe(16))


class AccountError(ValueError):
    """An account that cannot be made or changed like that; `code` is a key below `account_errors` in lab.yaml."""

    def __init__(self, code: str, **values: Any) -> None:
        self.code, self.values = code, values
        super().__init__(f"account: {code} ({', '.join(f'{k} = {v!r}' for k, v in values.items())})")


class NotSignedIn(Exception):
    """Nobody is signed in here (or no longer)."""


class PasswordMustChange(Exception):
    """Signed in with a printed first-run password, which has to be changed before anything else."""


def ensure_first_user(database: Database, *, must_change: bool = True) -> str | None:
    """Make the user `experimenter` where no user exists yet. Returns its random password, once, else None."""
    with database.transaction() as s:
        if s.scalar(select(User.id).limit(1)) is not None:
            return None
        password = new_password()
        hashed = _hasher.hash(password)
        s.add(User(name=FIRST_USER, password_hash=hashed, must_change_password=must_change, role="owner"))
        return password


def add_user(database: Database, name: str, role: str) -> str:
    """Make another account; returns the password to hand over, which its owner changes at first use.

    Raises AccountError for a name that is taken or not 2-40 of a-z, 0-9, dot, dash, underscore, or an unknown role.
    """
    name = name.strip().lower()
    if role not in ROLES:
        raise AccountError("role_unknown", role=role, roles=", ".join(ROLES))
    if not USER_NAME.fullmatch(name):
        raise AccountError("name_form", name=name)
    with database.transaction() as s:
        if s.scalar(select(User.id).where(User.name == name)) is not None:
            raise AccountError("name_taken", name=name)
        password = new_password()
        s.add(User(name=name, password_hash=_hasher.hash(password), must_change_password=True, role=role))
        return password


def set_role(database: Database, name: str, role: str) -> None:
    """Give an account another role, from the next request on. Raises AccountError for an unknown name or role, or if no
    owner would be left."""
    if role not in ROLES:
        raise AccountError("role_unknown", role=role, roles=", ".join(ROLES))
    with database.transaction() as s:
        if role != "owner":
            check_owner_left(s, name)
        user = s.scalar(select(User).where(User.name == name))
        if user is None:
            raise AccountError("name_unknown", name=name)
        user.role = role


def check_owner_left(s: DatabaseSession, without: str) -> None:
    """Raises AccountError where nobody but `without` is an owner: two who take the role from each other at once would
    leave none. Whoever comes second waits here for the first, and then counts as they are by then."""
    owners = select(User).where(User.role == "owner").order_by(User.id)
    names = {one.name for one in s.scalars(owners.with_for_update().execution_options(populate_existing=True))}
    if names == {without}:
        raise AccountError("last_owner")


def reset_password(database: Database, name: str) -> str:
    """Give an account a new random password and sign it out everywhere. Raises AccountError for an unknown name."""
    with database.transaction() as s:
        user = s.scalar(select(User).where(User.name == name))
        if user is None:
            raise AccountError("name_unknown", name=name)
        password = new_password()
        user.password_hash, user.must_change_password = _hasher.hash(password), True
        s.execute(delete(SignIn).where(SignIn.user_id == user.id))
        return password


def change_password(database: Database, user_id: str, current: str, new: str, *, keep: bytes | None = None) -> None:
    """Change a password and sign the account out in every browser but the one whose token hash is `keep`.

    Raises AccountError: the current password is wrong, or the new one is too short, too long or no change.
    """
    with database.session() as s:
        user = s.get(User, user_id)
        if user is None or not _verified(user.password_hash, current):
            raise AccountError("current_wrong")
    if not SHORTEST_PASSWORD <= len(new) <= LONGEST_PASSWORD:
        raise AccountError("password_length", shortest=SHORTEST_PASSWORD, longest=LONGEST_PASSWORD)
    if new == current:
        raise AccountError("password_same")
    new_hash = _hasher.hash(new)
    with database.transaction() as s:
        user = s.get_one(User, user_id)
        user.password_hash, user.must_change_password = new_hash, False
        others = delete(SignIn).where(SignIn.user_id == user_id)
        s.execute(others.where(SignIn.token_hash != keep) if keep else others)


def new_password() -> str:
    """Five groups of four letters and digits that are hard to misread: about 97 bits."""
    letters = "abcdefghjkmnpqrstuvwxyz23456789"
    return "-".join("".join(secrets.choice(letters) for _ in range(4)) for _ in range(5))


def safe_next(address: str | None) -> str:
    """Where to go after signing in: a path of our own signed-in pages, else the studies list."""
    fallback = "/lab/studies"
    if not address or not re.fullmatch(r"/lab(/[^\\\s\x00-\x1f]*)?", address) or address.startswith("//"):
        return fallback
    parts = urlsplit(address)
    return fallback if parts.scheme or parts.netloc or "/.." in parts.path else address


def signed_in(request: Request, database: Db) -> User:
    """The signed-in user, also on `request.state.sign_in` for templates. Raises NotSignedIn, PasswordMustChange."""
    token = request.cookies.get(COOKIE)
    if not token:
        raise NotSignedIn
    with database.session() as s:
        found = s.execute(
            select(User, SignIn.csrf)
            .join(SignIn, SignIn.user_id == User.id)
            .where(SignIn.token_hash == _hashed(token), SignIn.expires_at > utc_now())
        ).one_or_none()
        if found is None:
            raise NotSignedIn
        user, csrf = found
        given = s.execute(select(StudyRole.study_id, StudyRole.role).where(StudyRole.user_id == user.id))
        rights = rights_of(user.role, [(study, role) for study, role in given])
        s.expunge(user)
    request.state.sign_in = SignInState(user.name, user.role, csrf, user.must_change_password, rights)
    if user.must_change_password and request.url.path not in ("/lab/password", "/lab/sign-out"):
        raise PasswordMustChange
    return user


SignedIn = Annotated[User, Depends(signed_in)]


async def checked_csrf(request: Request, user: SignedIn) -> User:
    """Refuse what the role does not allow, and any changing request without this sign-in's CSRF token or from another
    origin. Returns the user."""
    rule = rule_of(request.method, route_of(request))
    rights = request.state.sign_in.rights
    allowed = rule is not None and (
        rule.right is None
        or rule.right in rights.everywhere
        or await run_in_threadpool(allows, services_of(request).database, rights, rule.right, request.path_params)
    )
    if rule is not None and rule.action:
        audited(request, rule.action, by=user.name, role=user.role, outcome="done" if allowed else "refused")
    if not allowed:
        raise LabRefusal(403, "role", role=user.role)
    if request.method in ("GET", "HEAD", "OPTIONS"):
        return user
    _refuse_foreign_origin(request)
    given = request.headers.get("X-CSRF")
    if given is None:
        field = (await request.form()).get("csrf")
        given = field if isinstance(field, str) else ""
    if not hmac.compare_digest(given.encode(), request.state.sign_in.csrf.encode()):
        raise LabRefusal(403, "csrf")
    return user


CheckedCsrf = Annotated[User, Depends(checked_csrf)]
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
def sign_in_page(request: Request, next: str = "") -> Response:
    return lab_page(request, "lab/sign_in.html", next=safe_next(next), name="", problem=None)


@router.post("/lab/sign-in")
def sign_in(
    request: Request,
    database: Db,
    name: Annotated[str, Form()] = "",
    password: Annotated[str, Form()] = "",
    next: Annotated[str, Form()] = "",
) -> Response:
    """Check name and password; sets the cookie and goes to `next`. 401 when wrong, 429 after too many attempts."""
    _refuse_foreign_origin(request)
    name = name.strip().lower()[:80]
    with database.session() as s:
        user = s.scalar(select(User).where(User.name == name))
        known_hash = user.password_hash if user else _nobody()
        user_id = user.id if user else None
    device = known_device(request, name, known_hash) if user else None
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

    for limit, key in windows:
        if not count(request, limit, key):
            reset_at = services_of(request).limiter.get_window_stats(limit, key).reset_time
            seconds = max(1, round(reset_at - utc_now().timestamp()))
            refused = again(429, "too_many", minutes=-(-seconds // 60))
            refused.headers["Retry-After"] = str(seconds)
            return refused
    if not _verified(known_hash, password[:LONGEST_PASSWORD]) or user_id is None:
        with database.transaction() as s:
            log_event(s, "sign_in_refused")
            record(s, "sign_in_refused", by=name if user_id else NOBODY, outcome="refused")
        return again(401, "wrong")
    services_of(request).limiter.clear(*windows[0])
    audited(request, "signed_in", by=name)
    token, now = secrets.token_urlsafe(32), utc_now()
    with database.transaction() as s:
        s.execute(delete(SignIn).where(SignIn.expires_at < now))
        s.add(
            SignIn(
                token_hash=_hashed(token),
                user_id=user_id,
                csrf=secrets.token_urlsafe(32),
                expires_at=now + SIGN_IN_LASTS,
            )
        )
        if _hasher.check_needs_rehash(known_hash):
            s.get_one(User, user_id).password_hash = _hasher.hash(password)
    response = RedirectResponse(safe_next(next), status_code=303)
    response.set_cookie(
        COOKIE,
        token,
        max_age=int(SIGN_IN_LASTS.total_seconds()),
        httponly=True,
        samesite="lax",
        secure=_served_securely(request),
        path="/",
    )
    _know_device(request, response, name, known_hash, device)
    return response


def _windows(request: Request, name: str, device: str | None) -> list[tuple[RateLimitItem, str]]:
    """What an attempt counts towards. On a device that has signed in before, strangers' attempts count for nothing."""
    if device is not None:
        return [(ATTEMPTS_PER_DEVICE, f"device:{device}")]
    address = address_of(request)
    return [
        (ATTEMPTS_PER_NAME_AND_ADDRESS, f"name:{name} address:{address}"),
        (ATTEMPTS_PER_ADDRESS, f"address:{address}"),
        (ATTEMPTS_PER_NAME, f"name:{name}"),
    ]


def known_device(request: Request, name: str, known_hash: str) -> str | None:
    """The id of this browser, where it has signed in to that account since its password was set last."""
    device, _, proof = request.cookies.get(DEVICE_COOKIE, "").partition(".")
    return device if device and hmac.compare_digest(proof.encode(), _device_proof(device, name, known_hash)) else None


def _know_device(request: Request, response: Response, name: str, known_hash: str, device: str | None) -> None:
    """Let this browser show later that it has signed in; what it keeps opens nothing."""
    device = device or secrets.token_hex(16)
    response.set_cookie(
        DEVICE_COOKIE,
        f"{device}.{_device_proof(device, name, known_hash).decode()}",
        max_age=int(DEVICE_LASTS.total_seconds()),
        httponly=True,
        samesite="lax",
        secure=_served_securely(request),
        path="/lab/sign-in",
    )


def _device_proof(device: str, name: str, known_hash: str) -> bytes:
    return hmac.new(known_hash.encode(), f"{device} {name}".encode(), hashlib.sha256).hexdigest().encode()


@router.post("/lab/sign-out")
def sign_out(request: Request, database: Db, user: CheckedCsrf) -> Response:
    with database.transaction() as s:
        s.execute(delete(SignIn).where(SignIn.token_hash == _hashed(request.cookies[COOKIE])))
    response = RedirectResponse("/lab/sign-in", status_code=303)
    response.delete_cookie(COOKIE, path="/", httponly=True, samesite="lax", secure=_served_securely(request))
    return response


@router.get("/lab/password")
def password_page(request: Request, user: SignedIn) -> Response:
    return lab_page(request, "lab/password.html", problem=None, shortest=SHORTEST_PASSWORD)


@router.post("/lab/password")
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
        change_password(database, user.id, current, new, keep=_hashed(request.cookies[COOKIE]))
    except AccountError as problem:
        return lab_page(request, "lab/password.html", status=422, problem=problem, shortest=SHORTEST_PASSWORD)
    return RedirectResponse("/lab/studies?done=password_changed", status_code=303)


def _hashed(token: str) -> bytes:
    return hashlib.sha256(token.encode()).digest()


def _verified(password_hash: str, password: str) -> bool:
    try:
        return _hasher.verify(password_hash, password)
    except (VerificationError, InvalidHashError):
        return False


def _served_securely(request: Request) -> bool:
    """Whether the cookie may insist on TLS: always at a public https address, save for maintenance on this machine."""
    if request.url.scheme == "https":
        return True
    return public_url(request).startswith("https://") and request.url.hostname not in ("127.0.0.1", "localhost", "::1")


def _refuse_foreign_origin(request: Request) -> None:
    """The stage lives on another port of this host and gets the same cookies: only our own pages may post here.

    Sec-Fetch-Site comes first: our Referrer-Policy makes browsers send `Origin: null` with plain forms.
    """
    site, origin = request.headers.get("Sec-Fetch-Site"), request.headers.get("Origin")
    if site is not None:
        foreign = site not in ("same-origin", "none")
    else:
        ours = (request.headers.get("Host"), urlsplit(public_url(request)).netloc)
        foreign = origin is not None and urlsplit(origin).netloc not in ours
    if foreign:
        raise LabRefusal(403, "foreign_origin")


def _not_signed_in(request: Request, problem: Exception) -> Response:
    if request.url.path.startswith("/api/"):
        return JSONResponse({"error": {"code": "not_signed_in", "message": "Sign in first at /lab/sign-in."}}, 401)
    asked = request.url.path + (f"?{request.url.query}" if request.url.query else "")
    back = safe_next(asked) if request.method == "GET" else "/lab/studies"
    return RedirectResponse(f"/lab/sign-in?next={quote(back, safe='')}", status_code=303)


def _password_must_change(request: Request, problem: Exception) -> Response:
    if request.url.path.startswith("/api/"):
        message = "Change the printed password first at /lab/password."
        return JSONResponse({"error": {"code": "password_must_change", "message": message}}, 403)
    return RedirectResponse("/lab/password", status_code=303)


exception_handlers = {
    NotSignedIn: _not_signed_in,
    PasswordMustChange: _password_must_change,
    LabRefusal: lab_refusal,
}
