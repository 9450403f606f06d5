"""What opens a door never enters a log line: keys that name such things, and the forms that they have inside texts.

A net below the rule that nobody logs them; what the append-only log of events refuses stands in `events.py`.
"""

from __future__ import annotations

import re
from collections.abc import MutableMapping
from typing import Any

TAKEN_OUT = "[taken out]"
LONGEST = 64 * 1024  # characters of a text that a line keeps, ours: what is longer was never meant to be read
KEYS = re.compile(
    r"(?i)(^|_)(tokens?|cookies?|passwords?|csrf|secrets?|authorization|verifier|nonce|completion_code|recovery_codes?)$"
)
FORMS = (
    # links that let somebody in: a session, a study's door, a stage
    (re.compile(r"(/(?:p|join|stage|session|preview-stage)/)[A-Za-z0-9_-]{8,}"), r"\1" + TAKEN_OUT),
    (re.compile(r"(?i)\b(bearer|basic)\s+[A-Za-z0-9._~+/=-]{6,}"), r"\1 " + TAKEN_OUT),
    (re.compile(r"(://[^\s:/@]*:)[^\s@/]+@"), r"\1" + TAKEN_OUT + "@"),  # a password in an address
    (re.compile(r"(?i)\b(code|state|token|password|csrf|secret|X-Amz-Signature)=[^&\s'\"]+"), r"\1=" + TAKEN_OUT),
    (re.compile(r"(desirepath_[a-z0-9_]{1,40}=)[^;\s'\"]+"), r"\1" + TAKEN_OUT),  # our cookies
    (re.compile(r"\beyJ[A-Za-z0-9_-]{8,}[A-Za-z0-9_.-]*"), TAKEN_OUT),  # signed tokens (JWT), and parts of one
)


def scrub(_logger: Any, _method: str, line: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """A processor of structlog: the line without what opens a door."""
    return {key: TAKEN_OUT if KEYS.search(key) else _value(value) for key, value in line.items()}


def _value(value: Any) -> Any:
    if isinstance(value, str):
        value = value[:LONGEST]
        for form, instead in FORMS:
            value = form.sub(instead, value)
        return value
    if isinstance(value, dict):
        return {key: TAKEN_OUT if KEYS.search(str(key)) else _value(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_value(item) for item in value]
    return value
