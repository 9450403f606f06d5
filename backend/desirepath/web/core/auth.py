"""Who may use the signed-in pages: accounts, passwords, roles, CSRF. What those pages show lives elsewhere.

A signed-in browser holds a random token in an HttpOnly cookie; the database holds its sha256 only. Every signed-in
page takes `SignedIn`; every router of such pages is made with `dependencies=[Depends(checked_csrf)]`, which also holds
the roles (`roles.py`) and the audit log (`auditing.py`).
"""

from __future__ import annotations

import hmac
import re
import secrets
from functools import cache
from typing import Annotated, Any
from urllib.parse import quote, urlsplit

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError
from fastapi import Depends, Request
from sqlalchemy import select, update
from sqlalchemy.orm import Session as DatabaseSession
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, RedirectResponse, Response

from desirepath.store.database import Database
from desirepath.store.models import SignIn, StudyRole, User, utc_now
from desirepath.web.core.auditing import note_in_audit
from desirepath.web.core.dependencies import Db, public_url, route_of, services_of
from desirepath.web.core.lab_frame import LabRefusal, SignInState, lab_refusal
from desirepath.web.core.opening_link import FIRST_USER, LINK, first_without_password, still_holds
from desirepath.web.core.permits import allows
from desirepath.web.core.roles import ROLES, rights_of, rule_of
from desirepath.web.core.second_factor import has_second_factor, is_asked_for
from desirepath.web.core.sign_ins import COOKIE, end_all, hash_token, note_seen

SECOND_FACTOR = "/lab/account/second-factor"
NOBODY = "-"  # in the audit log, for a name that is none: it may be a password typed into the wrong field
SHORTEST_PASSWORD = 12  # characters (ours); NIST SP 800-63B asks for length, not for mixtures
LONGEST_PASSWORD = 200  # hashing has a cost; nobody types more
USER_NAME = re.compile(r"[a-z0-9][a-z0-9._-]{1,39}")
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


class SecondFactorMissing(Exception):
    """Signed in without a second factor where this installation asks owners, or everybody, for one."""


def ensure_first_user(database: Database, *, must_change: bool = True, by_link: bool = False) -> str | None:
    """Make the user `experimenter` where no user exists yet. Returns its random password, once, else None.

    by_link: without a password, it opens by an address that is printed (`opening_link.py`). Where it was made so and
    the installation is open to others by now, it gets its password here.
    """
    with database.transaction() as s:
        if s.scalar(select(User.id).limit(1)) is None:
            password = "" if by_link else new_password()
            hashed = _hasher.hash(password) if password else ""
            s.add(
                User(
                    name=FIRST_USER,
                    password_hash=hashed,
                    must_change_password=must_change and not by_link,
                    role="owner",
                )
            )
            return password or None
        if by_link or first_without_password(s) is None:
            return None
    return reset_password(database, FIRST_USER)


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
    names = {owner.name for owner in s.scalars(owners.with_for_update().execution_options(populate_existing=True))}
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
        end_all(s, user.id)
        return password


def change_password(
    database: Database, user_id: str, current: str, new: str, *, keep: bytes | None = None, by_link: bool = False
) -> None:
    """Change a password and sign the account out in every browser but the one whose token hash is `keep`.

    by_link: who asks came by the link that opens an account without a password, and gives it its first one.
    Raises AccountError: the current password is wrong, or the new one is too short, too long or no change.
    """
    with database.session() as s:
        user = s.get(User, user_id)
        first = by_link and user is not None and not user.password_hash
        if user is None or not (first or verify_password(user.password_hash, current)):
            raise AccountError("current_wrong")
        checked = user.password_hash
    if not SHORTEST_PASSWORD <= len(new) <= LONGEST_PASSWORD:
        raise AccountError("password_length", shortest=SHORTEST_PASSWORD, longest=LONGEST_PASSWORD)
    if new == current:
        raise AccountError("password_same")
    new_hash = _hasher.hash(new)
    with database.transaction() as s:
        user = s.get(User, user_id, with_for_update=True)
        if user is None or user.password_hash != checked:  # somebody gave it another one meanwhile
            raise AccountError("current_wrong")
        user.password_hash, user.must_change_password = new_hash, False
        end_all(s, user_id, but=keep)
        s.execute(update(SignIn).where(SignIn.user_id == user_id, SignIn.method == LINK).values(method="password"))


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


def require_sign_in(request: Request, database: Db) -> User:
    """The signed-in user, also on `request.state.sign_in` for templates. Raises NotSignedIn, PasswordMustChange,
    SecondFactorMissing."""
    token = request.cookies.get(COOKIE)
    if not token:
        raise NotSignedIn
    with database.session() as s:
        found = s.execute(
            select(User, SignIn)
            .join(SignIn, SignIn.user_id == User.id)
            .where(SignIn.token_hash == hash_token(token), SignIn.expires_at > utc_now())
        ).one_or_none()
        if found is None:
            raise NotSignedIn
        user, sign_in = found
        if sign_in.method == LINK and not still_holds(s, request, user):
            raise NotSignedIn
        given = s.execute(select(StudyRole.study_id, StudyRole.role).where(StudyRole.user_id == user.id))
        rights = rights_of(user.role, [(study, role) for study, role in given])
        asked_for = is_asked_for(services_of(request).settings.second_factor, rights)
        missing = asked_for and not has_second_factor(s, user.id)
        s.expunge(user)
        seen_at, token_hash = sign_in.seen_at or sign_in.created_at, sign_in.token_hash
        csrf = sign_in.csrf
    note_seen(database, token_hash, seen_at)
    request.state.sign_in = SignInState(
        user.name, user.role, csrf, user.must_change_password or missing, rights, by_link=sign_in.method == LINK
    )
    path = request.url.path
    if user.must_change_password and path not in ("/lab/password", "/lab/sign-out"):
        raise PasswordMustChange
    if missing and not user.must_change_password and not path.startswith((SECOND_FACTOR, "/lab/sign-out")):
        raise SecondFactorMissing
    return user


def is_signed_in(request: Request, database: Database) -> bool:
    """Whether this browser is."""
    try:
        require_sign_in(request, database)
    except (NotSignedIn, PasswordMustChange, SecondFactorMissing):
        return False
    return True


SignedIn = Annotated[User, Depends(require_sign_in)]


async def check_csrf(request: Request, user: SignedIn) -> User:
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
        note_in_audit(request, rule.action, by=user.name, role=user.role, outcome="done" if allowed else "refused")
    if not allowed:
        raise LabRefusal(403, "role", role=user.role)
    if request.method in ("GET", "HEAD", "OPTIONS"):
        return user
    refuse_foreign_origin(request)
    given = request.headers.get("X-CSRF")
    if given is None:
        field = (await request.form()).get("csrf")
        given = field if isinstance(field, str) else ""
    if not hmac.compare_digest(given.encode(), request.state.sign_in.csrf.encode()):
        raise LabRefusal(403, "csrf")
    return user


CheckedCsrf = Annotated[User, Depends(check_csrf)]


def known_hash(user: User | None) -> str:
    """What a password is checked against; where there is none, something that takes as long and fits nothing."""
    return user.password_hash if user is not None and user.password_hash else _nobody()


def renew_hash(known: str, password: str) -> str | None:
    """The password hashed as it is done today, where the known hash is older; None where it is as good."""
    return _hasher.hash(password) if _hasher.check_needs_rehash(known) else None


def verify_password(password_hash: str, password: str) -> bool:
    """Whether the password is the one that was hashed."""
    try:
        return _hasher.verify(password_hash, password)
    except (VerificationError, InvalidHashError):
        return False


def is_served_securely(request: Request) -> bool:
    """Whether the cookie may insist on TLS: always at a public https address, save for maintenance on this machine."""
    if request.url.scheme == "https":
        return True
    return public_url(request).startswith("https://") and request.url.hostname not in ("127.0.0.1", "localhost", "::1")


def refuse_foreign_origin(request: Request) -> None:
    """The stage lives on another port of this host and gets the same cookies: only our own pages may post here.

    Sec-Fetch-Site comes first: our Referrer-Policy makes browsers send `Origin: null` with plain forms.
    """
    site, origin = request.headers.get("Sec-Fetch-Site"), request.headers.get("Origin")
    if site is not None:
        foreign = site not in ("same-origin", "none")
    else:
        ours = (request.headers.get("Host"), urlsplit(public_url(request)).netloc)
        foreign = origin is not None and origin.partition("://")[2] not in ours  # urlsplit raises for `http://[`
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


def _second_factor_missing(request: Request, problem: Exception) -> Response:
    if request.url.path.startswith("/api/"):
        message = f"Set up a second factor first at {SECOND_FACTOR}."
        return JSONResponse({"error": {"code": "second_factor_missing", "message": message}}, 403)
    return RedirectResponse(SECOND_FACTOR, status_code=303)


exception_handlers = {
    NotSignedIn: _not_signed_in,
    SecondFactorMissing: _second_factor_missing,
    PasswordMustChange: _password_must_change,
    LabRefusal: lab_refusal,
}
