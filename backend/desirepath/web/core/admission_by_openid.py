"""Whose account somebody is whom the OpenID provider vouches for, and who gets a new one.

An account belongs to issuer and subject, never to an e-mail address: those are given to somebody else in time. Who has
no account yet gets one by an invitation or an allowed address, both only where the provider has checked the address;
nobody becomes an owner by it.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from datetime import timedelta
from itertools import count

from sqlalchemy import delete, select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.models import Identity, Invitation, User, utc_now
from desirepath.web.core.auth import USER_NAME, AccountError
from desirepath.web.core.openid import Someone
from desirepath.web.core.roles import ROLES

EMAIL = re.compile(r"[^@\s\x00-\x1f]{1,64}@[a-z0-9](?:[a-z0-9.-]{0,185}[a-z0-9])?")
INVITATION_LASTS = timedelta(days=30)  # ours
INVITED_ROLES = tuple(role for role in ROLES if role != "owner")
ADMITTED_ROLE = "member"  # of who comes in by their address alone: sees nothing until a role is given


def is_admitted(email: str, allowed: Collection[str]) -> bool:
    """Whether an address is one of the allowed ones, or of an allowed domain (`uni.example`, not what ends like it)."""
    if not EMAIL.fullmatch(email):
        return False
    return email in allowed or email.rpartition("@")[2] in allowed


def account_of(s: DatabaseSession, someone: Someone) -> User | None:
    """The account that issuer and subject were linked to."""
    linked = select(User).join(Identity, Identity.user_id == User.id)
    return s.scalar(linked.where(Identity.issuer == someone.issuer, Identity.subject == someone.subject))


def new_account(s: DatabaseSession, someone: Someone, allowed: Collection[str]) -> User | None:
    """An account for who has none yet, linked; by an invitation, which is used up, else by an allowed address. None
    where there is no reason to let them in."""
    if not someone.email_verified:
        return None
    invitation = s.scalar(
        select(Invitation).where(Invitation.email == someone.email, Invitation.expires_at > utc_now()).with_for_update()
    )
    if invitation is not None:
        role = invitation.role if invitation.role in INVITED_ROLES else ADMITTED_ROLE
        s.delete(invitation)
    elif is_admitted(someone.email, allowed):
        role = ADMITTED_ROLE
    else:
        return None
    user = User(name=free_name(s, someone.wanted_name), password_hash="", role=role)
    s.add(user)
    s.flush()
    link(s, user.id, someone)
    return user


def link(s: DatabaseSession, user_id: str, someone: Someone) -> None:
    """From now on this issuer and subject open that account."""
    s.add(Identity(user_id=user_id, issuer=someone.issuer, subject=someone.subject, email=someone.email))


def invite(s: DatabaseSession, email: str, role: str, by: str) -> Invitation:
    """Let somebody with this address in once, with this role. Raises AccountError for what is no address, and for
    roles that are not given this way (owner)."""
    email = email.strip().lower()
    if not EMAIL.fullmatch(email):
        raise AccountError("no_email", email=email[:80])
    if role not in INVITED_ROLES:
        raise AccountError("role_unknown", role=role[:40], roles=", ".join(INVITED_ROLES))
    s.execute(delete(Invitation).where(Invitation.email == email))
    made = Invitation(email=email, role=role, invited_by=by, expires_at=utc_now() + INVITATION_LASTS)
    s.add(made)
    s.flush()
    return made


def free_name(s: DatabaseSession, wanted: str) -> str:
    """A name as accounts have it, as near to the wanted one as may be."""
    plain = re.sub(r"[^a-z0-9._-]", "", wanted.lower())[:36].lstrip("._-")
    base = plain if USER_NAME.fullmatch(plain) else f"{plain}-user" if USER_NAME.fullmatch(f"{plain}-user") else "user"
    for number in count(2):
        name = base
        if s.scalar(select(User.id).where(User.name == name)) is None:
            return name
        base = f"{(plain or 'user')[:32]}-{number}"
    raise AssertionError("unreachable: numbers do not end")
