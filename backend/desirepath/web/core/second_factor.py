"""Second factor: codes of an authenticator app (TOTP, RFC 6238), and recovery codes for who has lost it.

The secret stands in the database as it is, because codes are computed from it; who reads the database reads it too.
Recovery codes are kept as hashes. Pages and limits live in `lab/account_pages.py` and `lab/sign_in_pages.py`.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from datetime import datetime
from io import BytesIO
from typing import Any, Literal

import pyotp
import segno
from sqlalchemy import delete, func, or_, select, update
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.models import RecoveryCode, SecondFactor, utc_now
from desirepath.web.core.roles import Right, Rights

ISSUER = "Desire Path"
STEP_S = 30  # RFC 6238's default, the only one that every app knows
EARLIER_AND_LATER = 1  # steps for clocks that are off and slow typing (RFC 6238, 5.2)
RECOVERY_CODES = 8  # ours
LETTERS = "abcdefghjkmnpqrstuvwxyz23456789"
Passed = Literal["code", "recovery_code"]


def is_asked_for(policy: str, rights: Rights) -> bool:
    """Whether somebody with these rights has to have one: `offered`, `owners` (of anything) or `everybody`."""
    if policy == "owners":
        return Right.MANAGE in rights.everywhere or bool(rights.studies(Right.MANAGE))
    return policy == "everybody"


def has_second_factor(s: DatabaseSession, user_id: str) -> bool:
    """Whether an account has one that was confirmed."""
    return s.scalar(_confirmed(user_id)) is not None


def begin(s: DatabaseSession, user_id: str) -> str:
    """A new secret that counts once a code of it was typed in; one that counts already stays. Returns the secret."""
    s.execute(delete(SecondFactor).where(SecondFactor.user_id == user_id, SecondFactor.confirmed_at.is_(None)))
    secret = pyotp.random_base32()
    s.add(SecondFactor(user_id=user_id, secret=secret))
    return secret


def pending_secret(s: DatabaseSession, user_id: str) -> str | None:
    """The secret that waits for its first code."""
    waiting = select(SecondFactor.secret).where(SecondFactor.user_id == user_id, SecondFactor.confirmed_at.is_(None))
    return s.scalar(waiting)


def confirm(s: DatabaseSession, user_id: str, code: str) -> list[str] | None:
    """With the first right code the secret counts. Returns recovery codes, which are told once; None: a wrong code."""
    row = s.get(SecondFactor, user_id, with_for_update=True)
    if row is None or row.confirmed_at is not None:
        return None
    step = matching_step(row.secret, code, utc_now())
    if step is None:
        return None
    row.confirmed_at, row.last_step = utc_now(), step
    return new_recovery_codes(s, user_id)


def use_code(s: DatabaseSession, user_id: str, code: str) -> Passed | None:
    """Whether this is a code that was not used yet; it is used up by that. None: it is not."""
    typed = plain(code)
    if re.fullmatch(r"[0-9]{6}", typed):
        secret = s.scalar(_confirmed(user_id))
        step = matching_step(secret, typed, utc_now()) if secret else None
        if step is None:
            return None
        newer = or_(SecondFactor.last_step.is_(None), SecondFactor.last_step < step)
        used = update(SecondFactor).where(SecondFactor.user_id == user_id, newer).values(last_step=step)
        return "code" if s.execute(used).rowcount == 1 else None  # type: ignore[attr-defined]
    unused = RecoveryCode.user_id == user_id, RecoveryCode.code_hash == _hash(typed), RecoveryCode.used_at.is_(None)
    spent = update(RecoveryCode).where(*unused).values(used_at=utc_now())
    return "recovery_code" if s.execute(spent).rowcount == 1 else None  # type: ignore[attr-defined]


def matching_step(secret: str, code: str, now: datetime) -> int | None:
    """The 30 s of the clock whose code this is, of those around now; None: no such."""
    app, here, found = pyotp.TOTP(secret), int(now.timestamp()) // STEP_S, None
    for step in range(here - EARLIER_AND_LATER, here + EARLIER_AND_LATER + 1):
        if hmac.compare_digest(app.at(step * STEP_S).encode(), plain(code).encode()):
            found = step
    return found


def new_recovery_codes(s: DatabaseSession, user_id: str) -> list[str]:
    """Codes of which each opens once in the app's place; older ones stop. 79 bits each: a fast hash will do."""
    s.execute(delete(RecoveryCode).where(RecoveryCode.user_id == user_id))
    groups = [["".join(secrets.choice(LETTERS) for _ in range(4)) for _ in range(4)] for _ in range(RECOVERY_CODES)]
    codes = ["-".join(four) for four in groups]
    s.add_all(RecoveryCode(code_hash=_hash(plain(code)), user_id=user_id) for code in codes)
    return codes


def recovery_codes_left(s: DatabaseSession, user_id: str) -> int:
    """How many were not used yet."""
    unused = select(func.count()).where(RecoveryCode.user_id == user_id, RecoveryCode.used_at.is_(None))
    return s.scalar(unused) or 0


def remove(s: DatabaseSession, user_id: str) -> None:
    """The account signs in without one from now on."""
    s.execute(delete(RecoveryCode).where(RecoveryCode.user_id == user_id))
    s.execute(delete(SecondFactor).where(SecondFactor.user_id == user_id))


def picture(secret: str, name: str, where: str) -> str:
    """The QR code that apps read, as SVG without a header. where: the host, so that two installations are told apart"""
    address = pyotp.TOTP(secret).provisioning_uri(name=f"{name}@{where}", issuer_name=ISSUER)
    drawn = BytesIO()
    segno.make(address, error="m", micro=False).save(
        drawn, kind="svg", scale=4, border=4, xmldecl=False, svgns=True, dark="#000", light="#fff", omitsize=False
    )
    return drawn.getvalue().decode()


def plain(code: str) -> str:
    """What was typed, without the spaces and dashes that make it readable."""
    return re.sub(r"[\s-]", "", code).lower()[:64]


def _confirmed(user_id: str) -> Any:
    return select(SecondFactor.secret).where(SecondFactor.user_id == user_id, SecondFactor.confirmed_at.is_not(None))


def _hash(code: str) -> bytes:
    return hashlib.sha256(code.encode()).digest()
