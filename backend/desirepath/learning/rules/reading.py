"""A sentence as a rule: a small grammar of situations and places; what is left of the sentence is a wish, read by the
words room. What is not certain is asked back, never guessed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, cast, get_args

from desirepath.learning.rules.rule import MOST_CHANGES, MOST_CONDITIONS, Condition, RoomName, Rule, Thing, Wish, Zone
from desirepath.learning.words.lexicon import LONGEST, Language, Token, known_words, lexicon
from desirepath.learning.words.understanding import language_of_text, words_reader

ROOMS, THINGS = cast(tuple[str, ...], get_args(RoomName)), cast(tuple[str, ...], get_args(Thing))
PIECES = tuple(thing for thing in THINGS if thing != "person")
POSTURES = ("sitting", "standing", "walking")
SITUATIONS = (*POSTURES, "others", "alone", "hurry", "no_hurry")
MOST_BETWEEN = 3  # words from `in` to the room, from `near` to the thing


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


@dataclass
class _Span:
    """Tokens of the sentence that say when. main: outside a clause of its own."""

    tokens: list[Token]
    main: bool = False
    turned: bool = False


def read_rule(text: str, expected: Language) -> RuleRead:
    """Raises ValueError for more than LONGEST characters."""
    if len(text) > LONGEST:
        raise ValueError(f"a sentence has at most {LONGEST} characters, not {len(text)}")
    language = language_of_text(text, expected)
    tokens = lexicon(language, "rules").tokens(text)
    spans, rest = _situations(tokens, language)
    conditions: list[Condition] = []
    asked: list[Asked] = []
    for span in spans:
        found = _conditions(span)
        conditions += [one for one in found if one not in conditions]
        if not found and len(span.tokens) + span.main > 1:
            asked.append(Asked("context", span.tokens[0].words[0].start, span.tokens[-1].words[-1].end))
    zones, placed, used = _zones(rest)
    wish_tokens = [token for token in rest if token not in used]
    got = words_reader(language).understand(_only(text, wish_tokens))
    wishes: list[Wish] = []
    for mark in got.marks:
        wish = Wish(objective=mark.objective, more=mark.wanted)
        if not mark.waived and wish not in wishes:
            wishes.append(wish)
    if zones:
        got = replace(got, questions=())
    elif not wishes and not got.questions:
        zones = _forbidden(rest, placed)
        placed = [] if zones else placed
    for condition in _placed_conditions(rest, [one for one in placed if one in used]):
        if condition.kind in ("near",) and any(zone.kind != "thing" and zone.of for zone in zones):
            continue  # "between me and the sofa"
        if condition not in conditions and all(zone.of != condition.of for zone in zones):
            conditions.append(condition)
    asked += [Asked("wish", one.start, one.end, one.offered) for one in got.questions if one.about != "slowness"]
    if not wishes and not zones and not any(one.about == "wish" for one in asked):
        asked.append(Asked("nothing", 0, len(text)))
    here = next((token for token in rest if "here" in token), None)
    if any(zone.kind == "here" for zone in zones) and here is not None:
        asked.append(Asked("place", here.words[0].start, here.words[-1].end))
    conditions, wishes = _tidied(conditions[:MOST_CONDITIONS], wishes[:MOST_CHANGES])
    rule = Rule(words=text, when=tuple(conditions), wishes=tuple(wishes), zones=tuple(zones[:MOST_CHANGES]))
    return RuleRead(rule, tuple(asked), language)


def _only(text: str, tokens: Sequence[Token]) -> str:
    """The text with everything blank but these tokens, so that places in it stay what they are."""
    kept = [" "] * len(text)
    for token in tokens:
        for word in token.words:
            kept[word.start : word.end] = text[word.start : word.end]
    if tokens:
        for at in range(tokens[0].words[0].start, len(text)):
            if text[at] in ".,;!?:'’-":
                kept[at] = text[at]
    return "".join(kept).rstrip(" ,.;:") or " "


# ---- when ------------------------------------------------------------------------------------------------------------


def _situations(tokens: Sequence[Token], language: Language) -> tuple[list[_Span], list[Token]]:
    """The stretches that say when, and the tokens that are left."""
    spans: list[_Span] = []
    rest: list[Token] = []
    at = 0
    while at < len(tokens):
        token = tokens[at]
        if token.any("when", "unless") or _is_turned_round(tokens, at, language):
            end = _end_of_clause(tokens, at)
            if token.form in _NEAR_WHEN and any(one.any(*ROOMS, *THINGS, "me") for one in tokens[at + 1 : end]):
                rest.append(token)  # "bei mir", "beim Sofa"
                at += 1
                continue
            spans.append(_Span(list(tokens[at:end]), turned="unless" in token))
            at = end
            continue
        if "then" not in token:
            rest.append(token)
        at += 1
    alone = [token for k, token in enumerate(rest) if _stands_alone(rest, k)]
    for token in alone:  # "with guests", "at night": no clause, and still a situation
        if token not in rest:
            continue  # of the one before
        place = rest.index(token)
        if token.any("others", "hurry") and _is_object(rest, place):
            continue
        first = place - 1 if place and rest[place - 1].words[0].form in _WITH else place
        last = place + (2 if token.form == "beim" else 1)
        spans.append(_Span(rest[first:last], main=True))
        del rest[first:last]
    return spans, rest


_BEING = known_words("sollte sollten steht kommt bin sind ist haben habe hab hat gibt muss pressierts pressiert eilts")
_SELVES = ("ich", "wir")
_NEAR_WHEN = ("bei",)
_WITH = known_words("with around among amid mit bei unter for in im at on")


def _is_turned_round(tokens: Sequence[Token], at: int, language: Language) -> bool:
    """German without a conjunction: "Sitze ich, ...", "Bin ich allein, dann ...", "Keiner da? Dann ..."."""
    begins = at == 0 or tokens[at].before in (".", "?")
    after = tokens[at + 1 :]
    ends = next((k for k, token in enumerate(after) if token.before), None)
    if language != "de" or not begins:
        return False
    if tokens[at].any(*POSTURES) and after and after[0].words[0].form in _SELVES:
        return True
    if ends is None:
        return False
    verb = tokens[at].any(*POSTURES) or tokens[at].words[0].form in _BEING
    asks = after[ends].before == "?" and any(one.any(*SITUATIONS) for one in tokens[at : at + 1 + ends])
    says = any(one.any(*SITUATIONS) for one in tokens[at : at + 1 + ends])
    return asks or (verb and says and after[ends].before == ",")


def _stands_alone(tokens: Sequence[Token], at: int) -> bool:
    """ "With guests", "at night", "im Sitzen", "me sitting": no clause, and still a situation."""
    token = tokens[at]
    if token.any(*POSTURES):
        before = tokens[at - 1].words[-1].form if at else ""
        return before in ("me", "im", "beim") or (len(token.words) > 1 and token.words[0].form in ("im", "beim", "on"))
    if token.form == "beim" and at + 1 < len(tokens):  # "beim Staubsaugen"
        return tokens[at + 1].form.endswith("en") and not tokens[at + 1].any(*ROOMS, *THINGS)
    if "others" in token:
        return at == 0 or tokens[at - 1].words[0].form in _WITH
    return token.any("alone", "hurry", "no_hurry", "times")


def _is_object(tokens: Sequence[Token], at: int) -> bool:
    """ "Keep away from guests", "hurry up": it is said what to do, not when."""
    if "hurry" in tokens[at]:
        return True
    before = [word.form for token in tokens[max(0, at - 2) : at] for word in token.words]
    return bool({"from", "to", "von", "vom", "zu", "den", "the", "annoy", "disturb"} & set(before)) or at == 0


def _end_of_clause(tokens: Sequence[Token], at: int) -> int:
    """Where the clause that begins there ends: at a comma or a full stop, else behind what it says of a situation."""
    end = at + 1
    if end < len(tokens) and tokens[at].form in _BEFORE_NOUNS and tokens[end].words[0].form in _ARTICLES:
        return min(end + 2, len(tokens))  # "during the news"
    if end < len(tokens) and tokens[end].before == ",":
        end += 1  # "es sei denn, ich stehe"
    while end < len(tokens) and not tokens[end].before:
        end += 1
    joined = end < len(tokens) and tokens[end].before == "," and tokens[end].words[0].form in _JOINING
    if joined:
        end = _end_of_clause(tokens, end)
    if end < len(tokens):
        return end
    found = False
    for k in range(at + 1, end):
        says = tokens[k].any(*SITUATIONS, *ROOMS, *THINGS, "elsewhen", "me")
        if found and not says and not tokens[k].any("filler", "in", "near", "into", "through", "not", "when"):
            return k
        if found and tokens[k].any("stay", "not") and not says and "walking" not in tokens[k]:
            return k
        found = found or says
    return end


_BEFORE_NOUNS = known_words("waehrend during")
_ARTICLES = known_words("the my our a der des dem meiner meines unserer")
_JOINING = known_words("and und or oder")


def _conditions(span: _Span) -> list[Condition]:
    """What must hold, of one stretch; none where nothing is known of it."""
    tokens = span.tokens
    found: list[Condition] = []
    denied = span.turned
    postures = [token for token in tokens if token.any(*POSTURES)]
    for at, token in enumerate(tokens):
        if "not" in token:
            denied = not span.turned
        for kind in ("others", "hurry"):
            if kind in token:
                found.append(Condition(kind=kind, holds=not denied))
        if "alone" in token:
            found.append(Condition(kind="others", holds=span.turned))
        if "no_hurry" in token:
            found.append(Condition(kind="hurry", holds=span.turned))
        for kind in POSTURES:
            if kind in token and not _is_robots(tokens, at):
                found.append(Condition(kind=kind, holds=not denied))
        room = next((one for one in ROOMS if one in token), None)
        thing = next((one for one in PIECES if one in token), None)
        if room and not (room == "doorway" and thing):
            found.append(Condition(kind="room", of=cast(RoomName, room), holds=not denied))
        elif thing and not postures:
            found.append(Condition(kind="near", of=cast(Thing, thing), holds=not denied))
        elif "me" in token and any("near" in one for one in tokens) and not postures:
            found.append(Condition(kind="near", of="person", holds=not denied))
    if any(token.any("elsewhen", "times") for token in tokens):
        found = [one for one in found if one.kind not in ("room", "near")]
    if any(one.kind == "room" for one in found):
        found = [one for one in found if one.of != "person"]
    kept: list[Condition] = []
    for one in found:
        if one not in kept and one.kind not in [other.kind for other in kept if other.kind != "room"]:
            kept.append(one)
    return kept


_ROBOT = known_words("you it robot du er roboter dich")


def _is_robots(tokens: Sequence[Token], at: int) -> bool:
    """ "When you move past the sofa"."""
    before = [word.form for token in tokens[:at] for word in token.words]
    return any(form in _ROBOT for form in before[-2:]) and not any(form in ("i", "ich", "we", "wir") for form in before)


def _placed_conditions(tokens: Sequence[Token], placed: Sequence[Token]) -> list[Condition]:
    found: list[Condition] = []
    for token in placed:
        own = _segment(tokens, tokens.index(token))
        says_no_more = all(one.any("not", "only", "in", "through", "filler", *ROOMS) for one in own)
        spared = (
            says_no_more and any("not" in one for one in own) and len(own) < len(tokens)
        )  # ", but not in the bedroom"
        for room in ROOMS:
            if room in token:
                found.append(Condition(kind="room", of=cast(RoomName, room), holds=not spared))
        for thing in PIECES:
            if thing in token and not token.any(*ROOMS):
                found.append(Condition(kind="near", of=cast(Thing, thing)))
        if "passing" in token:
            found.append(Condition(kind="near", of="person"))
    return found


def _tidied(conditions: list[Condition], wishes: list[Wish]) -> tuple[list[Condition], list[Wish]]:
    """Slower near the person is an objective of its own."""
    near = Condition(kind="near", of="person")
    slower = {("faster", False), ("slower_near_person", True)}
    if near in conditions and wishes and all((one.objective, one.more) in slower for one in wishes):
        return [one for one in conditions if one != near], [Wish(objective="slower_near_person")]
    return conditions, wishes


# ---- where -----------------------------------------------------------------------------------------------------------


def _zones(tokens: Sequence[Token]) -> tuple[list[Zone], list[Token], list[Token]]:
    """Zones that a wish names by itself; tokens of places that may be zones or say where a wish holds; and the tokens
    that both were read of."""
    placed = _placed(tokens)
    between = next((k for k, token in enumerate(tokens) if "between" in token), None)
    if between is not None:
        after = tokens[between + 1 :]
        thing = next((one for token in after for one in PIECES if one in token), None)
        if not (thing and _is_denied(tokens, between) and any(token.any("andme", "me") for token in after)):
            return [], [], []
        rooms = [token for token in placed if token.any(*ROOMS) and not token.any(*PIECES)]
        return [Zone(kind="between", of=cast(Thing, thing))], rooms, [*_segment(tokens, between), *rooms]
    for sense, kept in (("sight", "front"), ("seen", "behind"), ("behind", "front"), ("front", "behind")):
        at = next((k for k, token in enumerate(tokens) if sense in token), None)
        if at is None:
            continue
        denied = _is_denied(tokens, at)
        if not denied and (sense == "front" or not any("stay" in token for token in _segment(tokens, at))):
            continue  # nothing says that it should be there
        kind = ("behind" if sense == "behind" else "front") if denied and sense in ("behind", "front") else kept
        used = [*_where(tokens, placed, away=False), *_segment(tokens, at)]
        return [Zone(kind=kind)], placed, used
    target = _kept_from(tokens)
    if target is not None and target.any(*PIECES) and not target.any("furniture", "wall"):
        of = cast(Thing, next(one for one in PIECES if one in target))
        used = _segment(tokens, tokens.index(target))
        others = [one for one in placed if one is not target]
        return [Zone(kind="thing", of=of)], others, [*used, *_where(tokens, others, away=False)]
    rooms = [token for token in placed if token.any(*ROOMS) and not token.any(*PIECES)]
    into = any(_is_denied(tokens, k) for k, token in enumerate(tokens) if "into" in token)
    if rooms and (_is_kept_out(tokens, rooms[0]) or into or (target is not None and target in rooms)):
        of_room = cast(RoomName, next(one for one in ROOMS if one in rooms[0]))
        return [Zone(kind="room", of=of_room)], [], _segment(tokens, tokens.index(rooms[0]))
    return (
        [],
        placed,
        _where(
            tokens, placed, away=target is not None or any(one.any(*ROOMS) or one.form in _NEARER for one in tokens)
        ),
    )


def _is_kept_out(tokens: Sequence[Token], room: Token) -> bool:
    """ "Out of the kitchen", "die Küche ist tabu"; not "I beg of you (bitt ich mir aus) that ..."."""
    at = tokens.index(room)
    before = tokens[max(0, at - MOST_BETWEEN) : at]
    own = _segment(tokens, at)
    return any("out" in token for token in before) or any("out" in one and one.form not in _OUT_OF for one in own)


def _segment(tokens: Sequence[Token], at: int) -> list[Token]:
    """The tokens between the punctuation around one of them."""
    first = next((k for k in range(at, 0, -1) if tokens[k].before), 0)
    last = next((k for k in range(at + 1, len(tokens)) if tokens[k].before), len(tokens))
    return list(tokens[first:last])


def _is_denied(tokens: Sequence[Token], at: int) -> bool:
    """Whether what stands there must not be: by its own part of the sentence, else by another."""
    own = _segment(tokens, at)
    if any("not" in token for token in own):
        return True
    return not any("stay" in token for token in own) and any("not" in token for token in tokens)


def _kept_from(tokens: Sequence[Token]) -> Token | None:
    """What "keep away from" is said of, where it is a thing or a room: of the person it is a wish."""
    for at, token in enumerate(tokens):
        if "away" not in token:
            continue
        after = next((one for one in tokens[at + 1 : at + 5] if one.any("me", *PIECES, *ROOMS)), None)
        if after is not None:
            return None if "me" in after and not after.any(*PIECES, *ROOMS) else after
        for k in range(at - 1, max(at - 6, -1), -1):  # "vom Sofa fern"
            if tokens[k].any(*PIECES, *ROOMS):
                own = tokens[max(k - 2, 0) : k]
                return tokens[k] if any(word.form in _FROM for one in own for word in one.words) else None
    return None


_OUT_OF = ("aus", "out", "out of")
_NEARER = known_words("closer nearer tighter enger knapper naeher dichter weiter farther further")
_FROM = known_words("von vom zu zur zum from to der dem den")


def _where(tokens: Sequence[Token], placed: Sequence[Token], away: bool) -> list[Token]:
    """Tokens that say where and not what: "in the kitchen", "near the sofa"; not "away from the walls"."""
    found: list[Token] = []
    for at, token in enumerate(tokens):
        if token not in placed or (away and token.any("furniture", "wall")):
            continue
        found.append(token)
        for before in reversed(tokens[max(0, at - MOST_BETWEEN) : at]):
            if not before.any("near", "in", "through", "into", "filler"):
                break
            found.append(before)
        found += [after for after in tokens[at + 1 : at + 3] if "near" in after]  # "am Sofa vorbei"
    return found


def _placed(tokens: Sequence[Token]) -> list[Token]:
    """Tokens of rooms, and of things that stand behind a word of place."""
    found: list[Token] = []
    for at, token in enumerate(tokens):
        before = tokens[max(0, at - MOST_BETWEEN) : at]
        if token.any(*PIECES):
            if any(one.any("near", "in", "through") for one in before) or token is _kept_from(tokens):
                found.append(token)
        elif token.any("passing", *ROOMS):
            found.append(token)
    return found


def _forbidden(tokens: Sequence[Token], placed: Sequence[Token]) -> list[Zone]:
    """What "not ..." forbids where nothing else is wished: a room, a thing, a place that is pointed at."""
    known = ("not", "away", "out", "stay", "filler", "in", "into", "near", "through", "here", "only", *ROOMS, *PIECES)
    if not any(token.any("not", "away", "out") for token in tokens) or not all(token.any(*known) for token in tokens):
        return []
    for token in placed:
        for room in ROOMS:
            if room in token:
                return [Zone(kind="room", of=cast(RoomName, room))]
        for thing in PIECES:
            if thing in token and thing not in ("furniture", "wall"):
                return [Zone(kind="thing", of=cast(Thing, thing))]
    return [Zone(kind="here")] if any("here" in token for token in tokens) else []
