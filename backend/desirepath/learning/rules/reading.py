"""A sentence as a rule: a small grammar of situations and places; what is left of the sentence is a wish, read by the
words room. What is not certain is asked back, never guessed.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

from desirepath.learning.rules.doubts import is_no_order, ordering, permitting
from desirepath.learning.rules.places import (
    allowed_only,
    complained_of,
    find_zones,
    forbidden,
    is_kept_from_inside,
    pointed_at,
    read_side,
)
from desirepath.learning.rules.rule import MOST_CHANGES, MOST_CONDITIONS, Condition, Rule, Wish, Zone
from desirepath.learning.rules.sentence import ORDERS, PIECES, POSTURES, SIDES, words_tokens
from desirepath.learning.rules.situations import (
    find_situations,
    find_unknown_place,
    only_passes,
    placed_conditions,
    read_conditions,
)
from desirepath.learning.rules.spelling import mend
from desirepath.learning.words.lexicon import LONGEST, Language, Token, form_of, known_words, lexicon
from desirepath.learning.words.readings import CALM, CARE
from desirepath.learning.words.understanding import Question, WordsReader, language_of_text


@dataclass(frozen=True)
class Asked:
    """What is asked back of the words from `start` to `end`. about: context: in which situation; wish: what is wished,
    one of `offered`; place: where, to be drawn; nothing: no wish was found."""

    about: Literal["context", "wish", "place", "nothing"]
    start: int
    end: int
    offered: tuple[str, ...] = ()


@dataclass(frozen=True)
class RuleRead:
    """rule: as far as it was understood; language: in which it was read."""

    rule: Rule
    asked: tuple[Asked, ...] = ()
    language: Language = "en"


def read_rule(text: str, expected: Language) -> RuleRead:
    """Raises ValueError for more than LONGEST characters."""
    if len(text) > LONGEST:
        raise ValueError(f"a sentence has at most {LONGEST} characters, not {len(text)}")
    language = language_of_text(text, expected)
    mended = mend(text, language)
    rule, asked = _read(mended.text[: 2 * LONGEST], language)
    asked = [replace(one, start=at[0], end=at[1]) for one in asked for at in [mended.typed(one.start, one.end)]]
    return RuleRead(rule.model_copy(update={"words": text}), tuple(asked), language)


def _read(text: str, language: Language) -> tuple[Rule, list[Asked]]:
    said = ordering(lexicon(language, "rules").tokens(text, mends=False), text)
    tokens = [token for token in said if "courtesy" not in token]
    spans, rest = find_situations(tokens, language)
    conditions: list[Condition] = []
    asked: list[Asked] = []
    for span in spans:
        found = read_conditions(span)
        turned = {one.model_copy(update={"holds": not one.holds}) for one in found}
        conditions = [one for one in conditions if one not in turned and one not in found] + found  # what is said last
        if not found and len(span.tokens) + span.main > 1 and not only_passes(span.tokens):
            asked.append(Asked("context", span.tokens[0].words[0].start, span.tokens[-1].words[-1].end))
    held = [one for one in conditions if one.holds and one.kind in (*POSTURES, "room")]
    if len({one.label for one in held if one.kind != "room"}) > 1 or sum(one.kind == "room" for one in held) > 1:
        asked.append(Asked("context", 0, len(text)))  # two rules in one: never both at once
    side = read_side(rest)
    allowed = allowed_only(rest, spans)
    zones, placed, used = find_zones(rest) if allowed is None else ([], [], [])
    if not zones and (complained := complained_of(spans, rest, tokens)) is not None:
        zones, asked = [complained], [one for one in asked if one.about != "context"]
    elif allowed is not None:
        zones, conditions = [allowed], [one.model_copy(update={"holds": not one.holds}) for one in conditions]
    pointed = [] if zones else pointed_at(rest, language)
    zones = [Zone(kind="here")] if pointed else zones
    no_wish = [*used, *pointed, *permitting(rest)]
    wish_tokens = [token for token in rest if token not in no_wish]
    if side is not None:
        wish_tokens = [token for token in wish_tokens if token not in side[1]]
    wishes, questions = _wishes(_only(text, wish_tokens), language)
    if side is not None:
        wishes = [side[0], *(one for one in wishes if one.objective not in SIDES)]
    if zones or side is not None:
        questions = []
    elif not wishes:
        zones = forbidden(rest, placed, bool(questions), language)
        placed = [] if zones else placed
        questions = [] if zones else questions

    def needless(own: Sequence[Token]) -> bool:
        return _needless(text[own[0].words[0].start : own[-1].words[-1].end], language)

    if allowed is None:
        zones = [zone for zone in zones if not is_no_order(said, zone, needless)]
    names = {one.objective for one in wishes}
    room = next((one for one in conditions if one.kind == "room" and one.holds), None)
    if room is not None and not wishes and not zones and not questions and is_kept_from_inside(rest):
        zones = [Zone(kind="room", of=room.of)]  # "when I'm in the bedroom, don't come in"
        conditions = [one for one in conditions if one != room]
    if (unknown := find_unknown_place(rest, language)) is not None:
        asked.append(Asked("context", unknown[0].words[0].start, unknown[-1].words[-1].end))
    for condition in placed_conditions(rest, [one for one in placed if one in used]):
        if condition.kind == "near" and any(zone.kind != "thing" and zone.of for zone in zones):
            continue  # "between me and the sofa"
        if condition.of == "person" and any(zone.kind in ("front", "behind") for zone in zones):
            continue  # "passing behind my back"
        kept = bool(names) and names <= {"farther", "closer"}
        hit = "clearance" in names and _is_hit(rest, wish_tokens)
        if condition.kind == "near" and (kept if condition.of == "person" else hit):
            continue  # "do not come near me", "don't crash into the chairs"
        if condition not in conditions and all(zone.of != condition.of for zone in zones):
            conditions.append(condition)
    if any(one.kind == "near" and one.of != "person" for one in conditions) and not any("me" in one for one in rest):
        wishes = [_OF_THINGS.get((one.objective, one.more), one) for one in wishes]  # "closer past the pillar"
    asked += [Asked("wish", one.start, one.end, one.offered) for one in questions]
    if not wishes and not zones and not questions:
        asked.append(Asked("nothing", 0, len(text)))
    here = next((token for token in rest if "here" in token), None)
    if any(zone.kind == "here" for zone in zones) and here is not None:
        asked.append(Asked("place", here.words[0].start, here.words[-1].end))
    slowed = any(one.any("slow") for token in wish_tokens for one in words_tokens(token.form, language))
    conditions, wishes = _tidied(conditions[:MOST_CONDITIONS], wishes[:MOST_CHANGES], slowed)
    rule = Rule(words="", when=tuple(conditions), wishes=tuple(wishes), zones=tuple(zones[:MOST_CHANGES]))
    return rule, asked


_OF_THINGS = {("closer", True): Wish(objective="clearance", more=False), ("farther", True): Wish(objective="clearance")}


def _is_hit(rest: Sequence[Token], left: Sequence[Token]) -> bool:
    """Whether things are named only as what must not be touched."""
    return any("not" in token for token in rest) and not any(token.any(*PIECES) for token in left)


def _wishes(text: str, language: Language) -> tuple[list[Wish], list[Question]]:
    """What the words room reads of what is left, and what it asks; what need not be is less of it."""
    needless = _needless(text, language)
    got = _reader(language, not needless).understand(text)
    wishes: list[Wish] = []
    for mark in got.marks:
        wish = Wish(objective=mark.objective, more=mark.wanted)
        if not mark.waived and wish not in wishes:
            wishes.append(wish)
    waived = {one.objective for one in got.marks if one.waived}
    if not wishes and not got.questions and (needless or waived == {"clearance"}):
        wishes = list({Wish(objective=one.objective, more=not one.wanted): 0 for one in got.marks if one.waived})
    questions = [one for one in got.questions if one.about != "slowness"]
    if not wishes and (ordered := _ordered(text, language)):
        wishes, questions = ordered, []
    if not wishes and questions and all(one.offered == CALM for one in questions):
        wishes = [Wish(objective="smoother")]  # "gently"
    if wishes:  # said again in other words: "slower, you whizz past"
        meant = {one.objective for one in wishes}
        same = [
            one for one in questions if one.about != "contradiction" and (one.offered == CARE or meant & {*one.offered})
        ]
        questions = [one for one in questions if one not in same]
    return wishes, questions


@lru_cache(maxsize=4)
def _reader(language: Language, doubts: bool = True) -> WordsReader:
    """Of short stretches, of which the second reader can only say that they mean the contrary. doubts: whether it is
    heard at all: "need not be so smooth" it takes for the contrary."""
    return WordsReader(language, doubts_unsaid=False) if doubts else WordsReader(language, lambda _: None)


def _ordered(text: str, language: Language) -> list[Wish]:
    """What those parts of a text wish that are plain orders, where the rest only tells why: "I'm sick of you wandering
    about, take the shortest way"."""
    found: list[Wish] = []
    for part in re.split(r"[,;.!?:]|\b(?:so|also|drum|deshalb|darum|deswegen|denn|and|und)\b", text)[1:]:
        words = [form_of(word, language) for word in part.split()]
        while words and words[0] in _LINKS:
            words.pop(0)
        if not words or not (words[0] in ORDERS or (len(words) > 1 and words[1] == "sie" and words[0].endswith("en"))):
            continue
        got = _reader(language).understand(part)
        if any(one.about != "slowness" for one in got.questions):
            return []
        found += [Wish(objective=one.objective, more=one.wanted) for one in got.marks if not one.waived]
    return list(dict.fromkeys(found))


_LINKS = known_words("so also then da dann und and but aber lieber bitte please just doch you therefore")


def _needless(text: str, language: Language) -> bool:
    said = [one for one in lexicon(language).tokens(text) if "needless" in one]
    return any(word.form.startswith(_NEEDS) for one in said for word in one.words)


_NEEDS = ("need", "brauch", "muss", "muess", "must", "have", "bother", "noetig", "necessary", "notwendig")


def _only(text: str, tokens: Sequence[Token]) -> str:
    """The text with everything blank but these tokens, so that places in it stay what they are."""
    kept = [" "] * len(text)
    for token in tokens:
        for word in token.words:
            if word.form == "you" and "not" in token:
                continue  # "don't you drive so fast" is no question
            kept[word.start : word.end] = text[word.start : word.end]
    if tokens:
        for at in range(tokens[0].words[0].start, len(text)):
            if text[at] in ".,;!?:'’-":
                kept[at] = text[at]
    return "".join(kept).rstrip(" ,.;:") or " "


def _tidied(conditions: list[Condition], wishes: list[Wish], slowed: bool) -> tuple[list[Condition], list[Wish]]:
    """Slower near the person is an objective of its own."""
    near = Condition(kind="near", of="person")
    slower = {("faster", False), ("slower_near_person", True)}
    if near in conditions and wishes and all((one.objective, one.more) in slower for one in wishes):
        return [one for one in conditions if one != near], [Wish(objective="slower_near_person")]
    if near in conditions and wishes == [Wish(objective="faster")] and slowed:  # "you need not brake beside me"
        return [one for one in conditions if one != near], [Wish(objective="slower_near_person", more=False)]
    return conditions, wishes
