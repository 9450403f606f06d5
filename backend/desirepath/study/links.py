"""Links into sessions and out of them: tokens, the next appointment's link and window, the way back with a code."""

from __future__ import annotations

import hashlib
import re
from typing import Any

from desirepath.store.models import Session

CODE_LETTERS = "23456789ABCDEFGHJKMNPQRSTUVWXYZ"  # nothing that is easily misread
LINK_LETTERS = 16  # 30^16 links: more than 2^78
GROUP = 4


def normalise_token(token: str) -> str:
    """A link's token as it was made: a code that was typed counts however it was written."""
    plain = re.sub(r"[\s-]", "", token).upper()
    return _group(plain) if len(plain) == LINK_LETTERS and set(plain) <= set(CODE_LETTERS) else token


def token_hash(token: str) -> str:
    """What is stored of a link's token."""
    return hashlib.sha256(normalise_token(token).encode()).hexdigest()


def next_token(token: str) -> str:
    """The token of the next appointment, short enough to be written down: XXXX-XXXX-XXXX-XXXX."""
    number = int.from_bytes(hashlib.sha256(f"next appointment:{token}".encode()).digest(), "big")
    letters = []
    for _ in range(LINK_LETTERS):
        number, letter = divmod(number, len(CODE_LETTERS))
        letters.append(CODE_LETTERS[letter])
    return _group("".join(letters))


def _group(letters: str) -> str:
    return "-".join(letters[i : i + GROUP] for i in range(0, len(letters), GROUP))


def window_of(session: Session) -> dict[str, Any]:
    """From when until when an appointment can be entered."""
    return {"opens_at": session.opens_at, "expires_at": session.expires_at}


def code_and_way_back(completion_code: str | None, url: str | None) -> dict[str, Any]:
    """What the last page tells of both, whoever it is shown to."""
    return {
        "completion_code": completion_code,
        "return_url": url.replace("{code}", completion_code or "") if url else None,
    }
