"""Links into sessions: what is stored of their tokens, and the one of the next appointment."""

from __future__ import annotations

import hashlib
import re

CODE_LETTERS = "23456789ABCDEFGHJKMNPQRSTUVWXYZ"  # nothing that is easily misread
LINK_LETTERS = 16  # 30^16 links: more than 2^78
GROUP = 4


def as_issued(token: str) -> str:
    """A link's token as it was made: a code that was typed counts however it was written."""
    plain = re.sub(r"[\s-]", "", token).upper()
    return _grouped(plain) if len(plain) == LINK_LETTERS and set(plain) <= set(CODE_LETTERS) else token


def token_hash(token: str) -> str:
    """What is stored of a link's token."""
    return hashlib.sha256(as_issued(token).encode()).hexdigest()


def next_token(token: str) -> str:
    """The token of the next appointment, short enough to be written down: XXXX-XXXX-XXXX-XXXX."""
    number = int.from_bytes(hashlib.sha256(f"next appointment:{token}".encode()).digest(), "big")
    letters = []
    for _ in range(LINK_LETTERS):
        number, letter = divmod(number, len(CODE_LETTERS))
        letters.append(CODE_LETTERS[letter])
    return _grouped("".join(letters))


def _grouped(letters: str) -> str:
    return "-".join(letters[i : i + GROUP] for i in range(0, len(letters), GROUP))
