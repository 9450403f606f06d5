"""Plain JSON data of any depth: bounding, reading and writing it, looking for names in it, copying it in part. Nothing
here recurses.

What browsers send is bounded where it enters, and every column once more where it is written (`dump_json`). What stands
deeper in a database all the same must be exported and erased.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Iterator
from typing import Any

import numpy as np

MOST_LEVELS = 64  # of what is stored and exported; ours, nothing of the product nests deeper than ten
LARGEST_JSON = 64 * 2**20  # bytes of one value; ours, the largest plans and job results have some hundred kB
CUT = f"[nested deeper than {MOST_LEVELS} levels]"
TOO_DEEP = "too_deep_to_read"  # key under which such a row's words stand
_WORD = re.compile(r'"(?:[^"\\]++|\\.)*+"?', re.DOTALL)  # never fails once begun, so nothing is read twice
_OPENS_AND_CLOSES = bytes.maketrans(b"[{]}", b"\x01\x01\xff\xff")  # +1 and -1 as signed bytes
_NO_BRACKETS = bytes(set(range(256)) - set(b"[]{}"))


class Unstorable(ValueError):
    """JSON that could not be read again as plain data; the message says why. Nothing of its change was stored."""


def without_texts(written: bytes) -> bytes:
    """JSON in UTF-8 without what stands within quotation marks. Linear in its bytes, whatever they are, and parses
    nothing; of what is no JSON, only what comes before the first mistake is right."""
    parts = written.replace(b"\\\\", b"").replace(b'\\"', b"").split(b'"')  # every other one stands within quotes
    return b"".join(parts[::2])


def is_deeper(written: bytes, limit: int) -> bool:
    """Whether JSON in UTF-8 has more than `limit` arrays and objects inside each other: as `without_texts` does it, and
    of its answer as well."""
    if written.count(b"[") + written.count(b"{") <= limit:
        return False
    signs = np.frombuffer(without_texts(written).translate(_OPENS_AND_CLOSES, _NO_BRACKETS), np.int8)
    return int(signs.cumsum(dtype=np.int32).max(initial=0)) > limit


def dump_json(value: Any) -> str:
    """Plain data as every JSON column is written. Raises Unstorable for what is too deep or too large to be read."""
    try:
        written = json.dumps(value)
    except RecursionError:
        raise Unstorable(f"has more than {MOST_LEVELS} arrays and objects inside each other") from None
    if len(written) > LARGEST_JSON:
        raise Unstorable(f"has {len(written)} bytes of JSON, at most {LARGEST_JSON} are stored")
    if is_deeper(written.encode(), MOST_LEVELS):
        raise Unstorable(f"has more than {MOST_LEVELS} arrays and objects inside each other")
    return written


def load_json(text: str | bytes) -> Any:
    """JSON as plain data; what Python cannot read because it nests too deep becomes {TOO_DEEP: [every word in it]}."""
    try:
        return json.loads(text)
    except RecursionError:
        written = text.decode() if isinstance(text, bytes) else text
        return {TOO_DEEP: [json.loads(word) for word in _WORD.findall(written)]}


def levels_of(data: Any) -> int:
    """How deep plain data nest: 0 for a number or a text."""
    deepest, waiting = 0, [(data, 0)]
    while waiting:
        item, level = waiting.pop()
        deepest = max(deepest, level)
        if isinstance(item, dict | list):
            waiting += [(inner, level + 1) for inner in (item.values() if isinstance(item, dict) else item)]
    return deepest


def words_of(data: Any) -> Iterator[str]:
    """Every key and every text of plain data."""
    waiting = [data]
    while waiting:
        value = waiting.pop()
        if isinstance(value, dict):
            yield from value
            waiting += value.values()
        elif isinstance(value, list):
            waiting += value
        elif isinstance(value, str):
            yield value


def mentions(data: Any, names: Collection[str]) -> bool:
    """Whether plain data hold one of the names, as a key or a value."""
    return any(word in names for word in words_of(data))


def copy_data(
    data: Any,
    *,
    text: Callable[[str], Any] = lambda item: item,
    without: Callable[[str, Any], bool] = lambda key, value: False,
    most_levels: int = MOST_LEVELS,
) -> Any:
    """A copy in which `text` was called on every text, entries and items are left out of which `without` is true (key,
    empty for items, and value), and what nests deeper than `most_levels` reads `CUT`.
    """
    holder: list[Any] = []
    waiting: list[tuple[Any, list[Any] | dict[str, Any], Any, int]] = [(data, holder, None, 0)]
    while waiting:
        item, into, key, level = waiting.pop()
        copied: Any
        if isinstance(item, dict):
            entries = [(name, inner) for name, inner in item.items() if not without(name, inner)]
            copied = dict.fromkeys(name for name, _ in entries)  # their order is the given one, however it is filled
            waiting += [(inner, copied, name, level + 1) for name, inner in entries if level < most_levels]
        elif isinstance(item, list):
            items = [inner for inner in item if not without("", inner)]
            copied = [None] * len(items)
            waiting += [(inner, copied, k, level + 1) for k, inner in enumerate(items) if level < most_levels]
        else:
            copied = text(item) if isinstance(item, str) else item
        if isinstance(item, dict | list) and item and level >= most_levels:
            copied = CUT
        if into is holder:
            holder.append(copied)
        else:
            into[key] = copied
    return holder[0]
