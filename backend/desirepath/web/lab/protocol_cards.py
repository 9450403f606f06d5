"""Shipped protocols as cards: a picture of what people do, made from the protocol; which one answers three questions.

What a card says in words is in the catalogues, below `lab.cards`, by the protocol's name.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from markupsafe import Markup

from desirepath.explain.sketches import HEIGHT, WIDTH, Points, Sketch, points_text, shipped_sketches
from desirepath.learning.shipped_files import load_card, shipped_names
from desirepath.study.protocol.freezing import FrozenProtocol, find_shipped_protocols, freeze
from desirepath.study.protocol.schema import Protocol

QUESTIONS: Mapping[str, tuple[str, ...]] = {
    "does": ("choose", "mark", "draw", "tell", "rule", "rank"),
    "moves": ("nobody", "people", "self"),
    "minutes": ("12", "15", "30", "60"),
}
"""What is asked, with the answers; the last are the most minutes of a session."""
COUNTS = {"does": 100, "moves": 10}  # what a card that is otherwise loses; a step of minutes costs 1
USUAL_ROOM = "study_room"
CLEAR_PX = 8  # badges keep so far from the picture's edge


@dataclass(frozen=True, eq=False)
class Card:
    """One shipped protocol. answers: what it is, by question; kinds: its stages', in order."""

    stem: str
    frozen: FrozenProtocol
    kinds: tuple[str, ...]
    answers: Mapping[str, str]
    picture: Markup


@lru_cache(maxsize=1)
def _cards(stems: tuple[str, ...]) -> tuple[Card, ...]:
    made = []
    for file in find_shipped_protocols():
        frozen = freeze(file)
        kinds = tuple(dict.fromkeys(entry.kind for entry in frozen.protocol.stages))
        answers = _answers(frozen.protocol, kinds)
        picture = _picture(frozen.protocol, answers)
        made.append(Card(file.stem, frozen, kinds, answers, picture))
    return tuple(
        sorted(made, key=lambda card: (QUESTIONS["does"].index(card.answers["does"]), card.frozen.protocol.minutes))
    )


def protocol_cards() -> tuple[Card, ...]:
    """All that come with the installation: by what people do there, short ones first."""
    return _cards(tuple(file.stem for file in find_shipped_protocols()))


def find_card(asked: Mapping[str, str], cards: Sequence[Card]) -> Card | None:
    """The one that comes nearest to what was answered; None where not all three are answered."""
    if not cards or any(asked.get(name) not in answers for name, answers in QUESTIONS.items()):
        return None

    def misses(card: Card) -> int:
        steps = QUESTIONS["minutes"]
        apart = abs(steps.index(card.answers["minutes"]) - steps.index(asked["minutes"]))
        return apart + sum(cost for name, cost in COUNTS.items() if card.answers[name] != asked[name])

    return min(cards, key=misses)


def unmet(asked: Mapping[str, str], card: Card) -> list[str]:
    """The questions that the card answers otherwise than was asked; a shorter one than asked is none."""
    steps = QUESTIONS["minutes"]
    longer = steps.index(card.answers["minutes"]) > steps.index(asked["minutes"])
    return [name for name in QUESTIONS if (longer if name == "minutes" else card.answers[name] != asked[name])]


def _answers(protocol: Protocol, kinds: Sequence[str]) -> dict[str, str]:
    """What a protocol is, for the three questions."""
    if "importance_ranking" in kinds:
        does = "rank"
    elif "rules" in kinds:
        does = "rule"
    elif "mark" in kinds:
        does = "mark"
    elif {"words", "tuning", "methods"} & set(kinds):
        does = "tell"
    else:
        does = "draw" if "demonstrations" in kinds else "choose"
    walks = any(getattr(entry.stage, "person", "still") != "still" for entry in protocol.stages)
    moves = "people" if _setup(protocol).startswith("crowd") else "self" if walks else "nobody"
    steps = QUESTIONS["minutes"]
    return {
        "does": does,
        "moves": moves,
        "minutes": next((one for one in steps if protocol.minutes <= int(one)), steps[-1]),
    }


def _setup(protocol: Protocol) -> str:
    return str(protocol.query_set or "").partition("/")[0] or USUAL_ROOM


def _sketches(setup: str) -> list[Sketch]:
    """Of a setup's policies that come with the product."""
    drawn = shipped_sketches()
    shas = [load_card(name).sha256 for name in shipped_names() if name.partition("/")[0] == setup]
    return [drawn[sha] for sha in shas if sha in drawn] or _sketches(USUAL_ROOM)


def _picture(protocol: Protocol, answers: Mapping[str, str]) -> Markup:
    """Line drawing of the setup with what people do in it; lab.css colours it."""
    sketches = _sketches(_setup(protocol))
    room = sketches[0]
    parts = [f'<polygon class="solid" points="{points_text(one)}"/>' for one in room.solids]
    x, y, r = room.goal
    parts.append(f'<circle class="goal" cx="{x}" cy="{y}" r="{r}"/>')
    parts += [f'<circle class="person" cx="{x}" cy="{y}" r="{r}"/>' for x, y, r in room.people]
    if answers["moves"] == "self":
        parts.append(_walk(room))
    a, b = _pair(sketches)
    does = answers["does"]
    if does == "choose":
        for path, letter, side in ((a, "A", 1), (b, "B", 2)):
            parts += [_path(path, f"line-{side}"), _badge(*path[len(path) // 2], letter)]
    elif does == "mark":
        parts += [_path(a, "line-1"), _badge(*a[len(a) // 3], "!"), _badge(*a[2 * len(a) // 3], "✓")]
    elif does == "draw":
        parts += [_path(a, "drawn"), _pen(*a[-1])]
    elif does in ("tell", "rule"):
        parts += [_path(a, "line-1"), _bubble()]
    else:
        parts.append(_path(a, "line-1"))
        inside = [_middle(one) for one in room.solids]
        spots = [(x, y) for x, y in inside if 0 < x < WIDTH and 0 < y < HEIGHT]
        spots = [(x, y) for x, y, _ in room.people] if answers["moves"] == "people" else spots
        clear = [spot for k, spot in enumerate(spots) if all(math.dist(spot, one) > 26 for one in spots[:k])]
        parts += [_badge(x, y, str(number)) for number, (x, y) in enumerate(clear[:3], start=1)]
    views = max(len((getattr(entry.stage, "each", None) or {}).get("view", ())) for entry in protocol.stages)
    if views > 1:
        parts += [_frame(number, views) for number in range(views)]
    return Markup(  # noqa: S704  numbers and letters of ours alone
        f'<svg class="card-picture" viewBox="0 0 {WIDTH} {HEIGHT}" aria-hidden="true">{"".join(parts)}</svg>'
    )


def _pair(sketches: Sequence[Sketch]) -> tuple[Points, Points]:
    """Two paths from one start that differ most, of two policies where the setup has some."""

    def apart(pair: tuple[Points, Points]) -> float:
        return math.dist(_middle(pair[0]), _middle(pair[1]))

    pairs = [(one, other) for sketch in sketches for one, other in zip(sketches[0].paths, sketch.paths, strict=False)]
    pairs += [(one, other) for one in sketches[0].paths for other in sketches[0].paths] if len(sketches) == 1 else []
    return max(pairs, key=apart)


def _middle(points: Points) -> tuple[int, int]:
    return round(sum(x for x, _ in points) / len(points)), round(sum(y for _, y in points) / len(points))


def _path(points: Points, css: str) -> str:
    x, y = points[0]
    return (
        f'<polyline class="{css}" points="{points_text(points)}"/><circle class="{css} start" cx="{x}" cy="{y}" r="5"/>'
    )


def _badge(x: int, y: int, letter: str) -> str:
    return f'<circle class="badge" cx="{x}" cy="{y}" r="12"/><text x="{x}" y="{y + 5}">{letter}</text>'


def _pen(x: int, y: int) -> str:
    return f'<path class="pen" d="M{x} {y}l6 -16 22 -26 10 9 -22 26z"/>'


def _bubble() -> str:
    return '<path class="bubble" d="M14 12h96v44h-60l-14 14v-14h-22z"/><path class="words" d="M26 27h72M26 40h50"/>'


def _frame(number: int, of: int) -> str:
    left = CLEAR_PX + 46 * number
    return f'<rect class="frame" x="{left}" y="{HEIGHT - 38}" width="40" height="30" rx="3"/>'


def _walk(room: Sketch) -> str:
    if not room.people:
        return ""
    x, y, r = room.people[0]
    return f'<path class="walk" d="M{x} {y - r - 4}v-34m-7 9l7 -9 7 9"/>'
