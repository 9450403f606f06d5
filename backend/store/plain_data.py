"""Plain JSON data of any depth: reading it, looking for names in it, copying it in part. Nothing here recurses.

What browsers send is bounded where it enters; rows of before those bounds must be exported and erased all the same.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Iterator
from typing import Any

MOST_LEVELS = 64  # of what is exported; ours, nothing of the product nests deeper than ten
CUT = f"[nested deeper than {MOST_LEVELS} levels]"
TOO_DEEP = "too_deep_to_read"  # key under which such a row's words stand
_WORD = re.compile(r'"(?:[^"\\]|\\.)*"')


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
        one, level = waiting.pop()
        deepest = max(deepest, level)
        if isinstance(one, dict | list):
            waiting += [(inner, level + 1) for inner in (one.values() if isinstance(one, dict) else one)]
    return deepest


def words_of(data: Any) -> Iterator[str]:
    """Every key and every text of plain data."""
    waiting = [data]
    while waiting:
        one = waiting.pop()
        if isinstance(one, dict):
            yield from one
            waiting += one.values()
        elif isinstance(one, list):
            waiting += one
        elif isinstance(one, str):
            yield one


def mentions(data: Any, names: Collection[str]) -> bool:
    """Whether plain data hold one of the names, as a key or a value."""
    return any(word in names for word in words_of(data))


def copied(
    data: Any,
    *,
    text: Callable[[str], Any] = lambda given: given,
    without: Callable[[str, Any], bool] = lambda key, value: False,
    most_levels: int = MOST_LEVELS,
) -> Any:
    """A copy in which `text` was called on every text, entries and items are left out of which `without` is true (key,
    empty for items, and value), and what nests deeper than `most_levels` reads `CUT`.
    """
    holder: list[Any] = []
    waiting: list[tuple[Any, list[Any] | dict[str, Any], Any, int]] = [(data, holder, None, 0)]
    while waiting:
        given, into, key, level = waiting.pop()
        made: Any
        if isinstance(given, dict):
            kept = [(name, inner) for name, inner in given.items() if not without(name, inner)]
            made = dict.fromkeys(name for name, _ in kept)  # their order is the given one, however it is filled
            waiting += [(inner, made, name, level + 1) for name, inner in kept if level < most_levels]
        elif isinstance(given, list):
            items = [inner for inner in given if not without("", inner)]
            made = [None] * len(items)
            waiting += [(inner, made, k, level + 1) for k, inner in enumerate(items) if level < most_levels]
        else:
            made = text(given) if isinstance(given, str) else given
        if isinstance(given, dict | list) and given and level >= most_levels:
            made = CUT
        if into is holder:
            holder.append(made)
        else:
            into[key] = made
    return holder[0]
