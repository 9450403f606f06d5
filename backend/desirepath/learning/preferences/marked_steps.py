"""Which steps of a trajectory a tap is about, and its others. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

Steps = tuple[int, int]
"""The first, and the one after the last."""
MOMENT_S = 2.0
"""How long before the tap what a mark is about began, its delay left out. Ours."""
REACTION_S = 0.5
"""From what is seen to the tap. Ours, between a simple reaction (0.2 s) and a judgement of what was seen (0.8 s)."""


def marked_steps(n: int, dt: float, taps_s: Sequence[float]) -> tuple[list[Steps], list[Steps]]:
    """What taps are about in a trajectory of n steps, and the rest of it, as `spans.marked_parts` says."""
    steps = round(MOMENT_S / dt)
    least, before = steps // 2, 0
    marked: list[Steps] = []
    others: list[Steps] = []
    for tap_s in sorted(taps_s):
        end = min(max(round((tap_s - REACTION_S) / dt), least), n)
        first = max(end - steps, before)
        if end - first < least:
            continue
        others += _evenly(before, first, steps)
        marked.append((first, end))
        before = end
    return marked, others + _evenly(before, n, steps)


def _evenly(first: int, end: int, steps: int) -> list[Steps]:
    """In parts of nearly so many steps each; none where there is less than half of that."""
    parts = (2 * (end - first) + steps - 1) // (2 * steps) if 2 * (end - first) >= steps else 0
    edges = [first + round((end - first) * k / parts) for k in range(parts + 1)] if parts else []
    return list(pairwise(edges))
