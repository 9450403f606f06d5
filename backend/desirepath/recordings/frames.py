"""Where frames are to each other, as a bag's transforms say (/tf, /tf_static): places of one frame in another, flat."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field

Placed = tuple[float, float, float]
"""x, y (m), yaw (rad)."""
DEEPEST = 32  # frames in a chain


@dataclass
class _Link:
    """Of a frame to its parent. places: at rising times; a static one has one at -inf."""

    parent: str
    times_s: list[float] = field(default_factory=list)
    places: list[Placed] = field(default_factory=list)

    def at(self, time_s: float) -> Placed:
        """The newest one, the first where there is none yet."""
        return self.places[max(0, bisect_right(self.times_s, time_s) - 1)]


class Frames:
    """The tree of a bag's frames."""

    def __init__(self) -> None:
        self._links: dict[str, _Link] = {}

    def add(self, time_s: float, parent: str, child: str, place: Placed, *, static: bool) -> None:
        """A transform. One whose time is before the last one's, or whose numbers are none, is left out."""
        parent, child = parent.lstrip("/"), child.lstrip("/")
        if not all(map(math.isfinite, place)) or parent == child:
            return
        link = self._links.get(child)
        if link is None or link.parent != parent:
            link = self._links[child] = _Link(parent)
        at = -math.inf if static else time_s
        if not link.times_s or at >= link.times_s[-1]:
            link.times_s.append(at)
            link.places.append(place)

    def known(self) -> list[str]:
        return sorted({*self._links, *(link.parent for link in self._links.values())})

    def links(self, frame: str, to: str) -> bool:
        """Whether places of one can be told in the other."""
        return self._chain(frame)[-1] == self._chain(to)[-1]

    def place(self, of: Placed, frame: str, to: str, time_s: float) -> Placed:
        """A place of `frame` in `to` at that time; a yaw that is NaN stays so."""
        base, other = self._in_root(frame, time_s), self._in_root(to, time_s)
        return _joined(_inverse(other), _joined(base, of))

    def _chain(self, frame: str) -> list[str]:
        chain = [frame.lstrip("/")]
        while (link := self._links.get(chain[-1])) is not None and len(chain) < DEEPEST:
            chain.append(link.parent)
        return chain

    def _in_root(self, frame: str, time_s: float) -> Placed:
        found: Placed = (0.0, 0.0, 0.0)
        for name in reversed(self._chain(frame)[:-1]):
            found = _joined(found, self._links[name].at(time_s))
        return found


def _joined(base: Placed, of: Sequence[float]) -> Placed:
    c, s = math.cos(base[2]), math.sin(base[2])
    return base[0] + c * of[0] - s * of[1], base[1] + s * of[0] + c * of[1], base[2] + of[2]


def _inverse(of: Placed) -> Placed:
    c, s = math.cos(of[2]), math.sin(of[2])
    return -c * of[0] - s * of[1], s * of[0] - c * of[1], -of[2]
