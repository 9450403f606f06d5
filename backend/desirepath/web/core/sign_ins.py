"""Signed-in browsers: their cookies, which there are, ending them. Who may sign in is decided elsewhere.

A browser holds a random token in an HttpOnly cookie, the database its sha256. Beside it stand, for who looks through
their own list, the address that it came from and the browser's name in a word; both go with the row.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import structlog
from fastapi import Request
from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import Response

from desirepath.store.database import Database, StorageError
from desirepath.store.models import SignIn, SignInUnderWay, utc_now
from desirepath.web.core.throttle import address_of

COOKIE = "desirepath_sign_in"
SIGN_IN_LASTS = timedelta(hours=12)  # (ours) one working day; the browser keeps the cookie no longer either
UNDER_WAY_COOKIE = "desirepath_signing_in"
UNDER_WAY_LASTS = timedelta(minutes=10)  # (ours) to find the phone, or the university's own second factor
DEVICE_COOKIE = "desirepath_known_device"
DEVICE_LASTS = timedelta(days=365)
SEEN_EVERY = timedelta(minutes=5)  # ours: how exactly `seen_at` is kept; a write per page would be one too many
BROWSERS = {"Edg/": "Edge", "OPR/": "Opera", "Firefox/": "Firefox", "Chrome/": "Chrome", "Safari/": "Safari"}
SYSTEMS = {
    "Windows": "Windows", "Android": "Android", "iPhone": "iOS", "iPad": "iOS",
    "Mac OS X": "macOS", "CrOS": "ChromeOS", "Linux": "Linux",
}  # fmt: skip
log = structlog.get_logger("desirepath.web")


@dataclass(frozen=True)
class OpenSignIn:
    """One signed-in browser, as its owner sees it. id: opens nothing; here: the browser that asks."""

    id: str
    since: datetime
    seen_at: datetime
    ends_at: datetime
    address: str
    browser: str
    method: str
    here: bool


def hash_token(token: str) -> bytes:
    """What the database keeps of a token."""
    return hashlib.sha256(token.encode()).digest()


def open_sign_in(s: DatabaseSession, request: Request, user_id: str, method: str) -> str:
    """A new sign-in of this browser; returns the token for its cookie. Sign-ins that have ended are forgotten."""
    token, now = secrets.token_urlsafe(32), utc_now()
    s.execute(delete(SignIn).where(SignIn.expires_at < now))
    s.add(
        SignIn(
            token_hash=hash_token(token),
            user_id=user_id,
            csrf=secrets.token_urlsafe(32),
            expires_at=now + SIGN_IN_LASTS,
            seen_at=now,
            address=address_of(request)[:64],
            browser=browser_name(request.headers.get("User-Agent", "")),
            method=method,
        )
    )
    return token


def keep_cookie(response: Response, token: str, *, secure: bool) -> None:
    """Give the browser the token of its sign-in."""
    seconds = int(SIGN_IN_LASTS.total_seconds())
    response.set_cookie(COOKIE, token, max_age=seconds, httponly=True, samesite="lax", secure=secure, path="/")


def note_seen(database: Database, token_hash: bytes, seen_at: datetime) -> None:
    """Write down that the browser was here, where that was last done some minutes ago. Never fails a request."""
    now = utc_now()
    if now - seen_at < SEEN_EVERY:
        return
    try:
        with database.transaction() as s:
            s.execute(update(SignIn).where(SignIn.token_hash == token_hash).values(seen_at=now))
    except StorageError:
        log.warning("a sign-in could not be noticed")


def list_sign_ins(database: Database, user_id: str, token: str) -> list[OpenSignIn]:
    """The signed-in browsers of an account, the asking one first, then who was here last."""
    with database.session() as s:
        rows = s.scalars(select(SignIn).where(SignIn.user_id == user_id, SignIn.expires_at > utc_now())).all()
    found = [
        OpenSignIn(
            public_id(row.token_hash),
            row.created_at,
            row.seen_at or row.created_at,
            row.expires_at,
            row.address or "",
            row.browser or "",
            row.method,
            row.token_hash == hash_token(token),
        )
        for row in rows
    ]
    return sorted(found, key=lambda one: (one.here, one.seen_at), reverse=True)


def end_one(s: DatabaseSession, user_id: str, sign_in_id: str) -> bool:
    """End the sign-in with this public id, if it is one of this account."""
    for row in s.scalars(select(SignIn).where(SignIn.user_id == user_id)):
        if hmac.compare_digest(public_id(row.token_hash).encode(), sign_in_id.encode()):
            s.delete(row)
            return True
    return False


def end_all(s: DatabaseSession, user_id: str, *, but: bytes | None = None) -> int:
    """End every sign-in of an account, save the one with this hash, and those that wait for a code: their password
    counted before. Returns how many were in."""
    s.execute(delete(SignInUnderWay).where(SignInUnderWay.user_id == user_id, SignInUnderWay.purpose == "code"))
    ended = delete(SignIn).where(SignIn.user_id == user_id)
    ended = ended.where(SignIn.token_hash != but) if but else ended
    return int(s.execute(ended).rowcount)  # type: ignore[attr-defined]


def public_id(token_hash: bytes) -> str:
    """A sign-in's name on pages; nothing of the token can be found from it."""
    return hashlib.sha256(b"sign-in " + token_hash).hexdigest()[:16]


def browser_name(user_agent: str) -> str:
    """`Firefox, Linux`; empty for what is neither."""
    words = [next((name for mark, name in known.items() if mark in user_agent), "") for known in (BROWSERS, SYSTEMS)]
    return ", ".join(word for word in words if word)


def begin_under_way(
    s: DatabaseSession, response_secret: str, purpose: str, data: Mapping[str, Any], user_id: str | None = None
) -> None:
    """Keep what a sign-in that needs another step has come to; `response_secret` is what the browser keeps of it."""
    now = utc_now()
    s.execute(delete(SignInUnderWay).where(SignInUnderWay.expires_at < now))
    s.add(
        SignInUnderWay(
            token_hash=hash_token(response_secret),
            purpose=purpose,
            user_id=user_id,
            data=dict(data),
            expires_at=now + UNDER_WAY_LASTS,
        )
    )


def keep_under_way_cookie(response: Response, secret: str, *, secure: bool) -> None:
    """Bind a sign-in under way to this browser."""
    response.set_cookie(
        UNDER_WAY_COOKIE,
        secret,
        max_age=int(UNDER_WAY_LASTS.total_seconds()),
        httponly=True,
        samesite="lax",  # the provider's answer is a link that is followed from elsewhere
        secure=secure,
        path="/lab",
    )


def under_way(s: DatabaseSession, request: Request, purpose: str) -> SignInUnderWay | None:
    """The sign-in that this browser has under way."""
    secret = request.cookies.get(UNDER_WAY_COOKIE)
    if not secret:
        return None
    found = s.get(SignInUnderWay, hash_token(secret))
    return found if found is not None and found.purpose == purpose and found.expires_at > utc_now() else None


def find_device(request: Request, name: str, known_hash: str) -> str | None:
    """The id of this browser, where it has signed in to that account since its password was set last."""
    device, _, proof = request.cookies.get(DEVICE_COOKIE, "").partition(".")
    return device if hmac.compare_digest(proof.encode(), _device_proof(device, name, known_hash)) else None


def know_device(response: Response, name: str, known_hash: str, device: str | None, *, secure: bool) -> None:
    """Let this browser show later that it has signed in; what it keeps opens nothing."""
    device = device or secrets.token_hex(16)
    response.set_cookie(
        DEVICE_COOKIE,
        f"{device}.{_device_proof(device, name, known_hash).decode()}",
        max_age=int(DEVICE_LASTS.total_seconds()),
        httponly=True,
        samesite="lax",
        secure=secure,
        path="/lab/sign-in",
    )


def _device_proof(device: str, name: str, known_hash: str) -> bytes:
    return hmac.new(known_hash.encode(), f"{device} {name}".encode(), hashlib.sha256).hexdigest().encode()
