"""The address with a one-time token by which the first account opens, before the installation is opened to others.

It holds while the server listens on loopback alone, no public address is set, and that account has no password: who
sets one signs in by it from then on. The database keeps the token's sha256, like every token's (`sign_ins.py`).
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from datetime import timedelta

from fastapi import Request
from sqlalchemy import delete, exists, select
from sqlalchemy.orm import Session

from desirepath.settings import Settings
from desirepath.store.models import Identity, Setting, SignInUnderWay, User, utc_now
from desirepath.web.core.addresses import LOOPBACK_NAMES, is_from_here
from desirepath.web.core.dependencies import services_of
from desirepath.web.core.sign_ins import hash_token

FIRST_USER = "experimenter"
PATH = "/lab/sign-in/once"
LINK = "link"
"""Purpose of the token's row, and method of the sign-ins that it opened."""
LINK_LASTS = timedelta(hours=1)  # ours: from reading the terminal to opening a browser, with a break
RELAYED = ("forwarded", "via", "x-forwarded-for", "x-forwarded-host", "x-forwarded-proto", "x-real-ip")
"""Headers of requests that somebody passed on."""


def link_path(s: Session, settings: Settings) -> str | None:
    """Path of a new address that opens once, within an hour; those before it stop. None where a password is asked."""
    user = _opened_by_link(s, settings)
    if user is None:
        return None
    token = secrets.token_urlsafe(32)
    s.execute(delete(SignInUnderWay).where(SignInUnderWay.purpose == LINK))
    expires_at = utc_now() + LINK_LASTS
    s.add(SignInUnderWay(token_hash=hash_token(token), purpose=LINK, user_id=user.id, data={}, expires_at=expires_at))
    return f"{PATH}?token={token}"


def use_token(s: Session, request: Request, token: str) -> User | None:
    """Whom the token opens the door for, once: it is gone then. None: it is wrong, used, too old or out of place."""
    user = _opened_by_link(s, services_of(request).settings)
    if user is None or not is_asked_here(request):
        return None
    known = s.scalar(
        select(SignInUnderWay.token_hash).where(
            SignInUnderWay.purpose == LINK, SignInUnderWay.user_id == user.id, SignInUnderWay.expires_at > utc_now()
        )
    )
    if known is None or not hmac.compare_digest(known, hash_token(token)):
        return None
    used = s.execute(delete(SignInUnderWay).where(SignInUnderWay.token_hash == known))
    return user if used.rowcount else None  # type: ignore[attr-defined]  # of two at once, one


def still_holds(s: Session, request: Request, user: User) -> bool:
    """Whether a browser that came by the link is still signed in: not once the installation is opened to others."""
    opened = _opened_by_link(s, services_of(request).settings)
    return opened is not None and opened.id == user.id and is_asked_here(request)


def awaits_link(s: Session, settings: Settings) -> bool:
    """Whether the first account opens by the link alone."""
    return _opened_by_link(s, settings) is not None


def is_closed(s: Session, settings: Settings) -> bool:
    """Whether nobody but this machine reaches the pages: it listens on loopback, and no public address is set."""
    row = s.get(Setting, "public_url")
    return _is_loopback(settings.host) and not settings.public_url and not (row and row.value.get("url"))


def is_asked_here(request: Request) -> bool:
    """Whether a browser on this machine asks for an address of this machine, and nobody passes it on."""
    relayed = any(name in request.headers for name in RELAYED)
    return is_from_here(request) and not relayed and _is_loopback(request.url.hostname or "")


def first_without_password(s: Session) -> User | None:
    """The first account where nobody has given it a password."""
    elsewhere = exists().where(Identity.user_id == User.id)  # who signs in at a university has no password either
    found = select(User).where(User.name == FIRST_USER, User.role == "owner", User.password_hash == "", ~elsewhere)
    return s.scalar(found)


def _opened_by_link(s: Session, settings: Settings) -> User | None:
    return first_without_password(s) if is_closed(s, settings) else None


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host in LOOPBACK_NAMES
