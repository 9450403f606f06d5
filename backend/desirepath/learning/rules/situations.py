"""When a rule holds: the stretches of a sentence that say so, and the conditions that they name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

from desirepath.learning.rules.rule import Condition, RoomName, Thing
from desirepath.learning.rules.sentence import (
    MOST_BETWEEN,
    NEARER,
    ORDERS,
    PERSONS,
    PIECES,
    POSTURES,
    ROOMS,
    SITUATIONS,
    THINGS,
    is_wish,
    part,
    segment,
    words_tokens,
)
from desirepath.learning.words.caution import PLACES
from desirepath.learning.words.lexicon import Language, Token, known_words


@dataclass
class Span:
    """Tokens of the sentence that say when. main: outside a clause of its own."""

    tokens: list[Token]
    main: bool = False
    turned: bool = False


def find_unknown_place(tokens: Sequence[Token], language: Language) -> list[Token] | None:
    """Something that no home here has, where it says where: "in front of the mirror"."""
    for at, token in enumerate(tokens):
        before = tokens[max(0, at - MOST_BETWEEN) : at]
        near = next((k for k, one in enumerate(before) if one.any("near", "in") or one.form in _AT), None)
        own = segment(tokens, at)
        kept = any(one.any("away", "between", "me") for one in own) or _is_gap(own, language)
        if "elsewhere" in token and near is not None and not kept:
            return [*before[near:], token]
    return None


_AT = known_words("vor an am on at auf before unter under") | {"in front of", "in front", "vor dem", "vor der"}


def _is_gap(tokens: Sequence[Token], language: Language) -> bool:
    gap = ("far", "near", "gap", "clearance", "mind", "hit")
    return any(
        wish.any(*gap) and wish.form not in PLACES
        for one in tokens
        for wish in words_tokens(one.form, language)
        if not one.any("near")
    )


def find_situations(tokens: Sequence[Token], language: Language) -> tuple[list[Span], list[Token]]:
    """The stretches that say when, and the tokens that are left."""
    spans: list[Span] = []
    rest: list[Token] = []
    at = 0
    if (end := _heading(tokens)) > 0:  # "Guests here: keep away"
        spans.append(Span(list(tokens[:end]), main=True))
        at = end
    while at < len(tokens):
        token = tokens[at]
        if (end := _exception(tokens, at)) > at:
            spans.append(Span([one for one in tokens[at:end] if "not" not in one], turned=True))
            at = end
            continue
        if token.any("when", "unless") or _is_turned_round(tokens, at, language):
            end = _end_of_clause(tokens, at, language)
            if _is_what_is_liked(tokens, at, language):
                rest.append(token)
                at += 1
                continue
            if at and tokens[at - 1].form in _CONCEDING:  # "even if it takes longer": no condition
                if not any(one.any(*SITUATIONS) for one in tokens[at:end]):
                    rest += tokens[at:end]
                at = end
                continue
            if token.form in _NEAR_WHEN and any(one.any(*ROOMS, *THINGS, "me") for one in tokens[at + 1 : end]):
                rest.append(token)  # "bei mir", "beim Sofa"
                at += 1
                continue
            turned = "unless" in token
            if "when" in token and (first := _denied_before(rest, token)) is not None:  # ", just not when I sit"
                del rest[first:]
                turned = True
            spans.append(Span(list(tokens[at:end]), turned=turned))
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
        if "times" in token and spans and _is_told(rest, place):
            continue  # "After work I drop on the sofa, and when I sit ..."
        first = place - 1 if place and rest[place - 1].words[0].form in _WITH else place
        last = place + (2 if token.form == "beim" else 1)
        last += last < len(rest) and rest[last].form in _PRESENT and "others" in token
        spans.append(Span(rest[first:last], main=True))
        del rest[first:last]
    return spans, rest


def _is_what_is_liked(tokens: Sequence[Token], at: int, language: Language) -> bool:
    """ "It would be nice if you went slower", "I hate it when you race": what is wished, not when. Of places a dislike
    stays a situation, which is read as a complaint."""
    after = tokens[at + 1 : at + 2]
    if not at or tokens[at].form not in _LIKED_IF or not after or after[0].words[0].form not in _ROBOT:
        return False
    before = tokens[part(tokens, at - 1)[0] : at]
    said = [one for token in before for one in words_tokens(token.form, language)]
    liked = any("good" in one for one in said) or any(token.form in _LIKED for token in before)
    disliked = any(one.any("bad", "not") for one in [*said, *before])
    if any(token.any("stay") and token.form in ORDERS for token in before):
        return False
    own = tokens[slice(*part(tokens, at))]
    where = any(one.any("front", "behind", "between", "left", "right") for one in own)
    return (liked or disliked) and not (disliked and where)


_LIKED_IF = known_words("if when wenn")
_LIKED = known_words("mind wohler lieber nice kind grateful appreciate nett lieb schoen recht froh dankbar")


_WHERE_AND_WHEN = (
    "filler", "may", "in", "near", "through", "here", "not", "me", "notme", "elsewhen", "times", *SITUATIONS, *ROOMS,
)  # fmt: skip
"""Senses of words that may stand in a part that only says when."""


def _heading(tokens: Sequence[Token]) -> int:
    """Where a first part ends that says nothing but when: "Besuch da und ich sitze:", "Sitting?"; 0: there is none."""
    end = next((k for k in range(1, len(tokens)) if tokens[k].before), 0)
    if not end or any(token.any("when", "unless") for token in tokens[:end]):
        return 0
    breaks = tokens[end].before in (".", "?") or "then" in tokens[end]
    says = any(token.any(*SITUATIONS, *ROOMS, "times") for token in tokens[:end])
    orders = any(token.any("out", "into", "away", "front", "behind") for token in tokens[:end])
    only = all(token.any(*_WHERE_AND_WHEN, "and", "andme") for token in tokens[:end]) and not orders
    denied = any("not" in token for token in tokens[:end])
    situation = any(token.any(*SITUATIONS) for token in tokens[:end])
    return end if breaks and says and only and (situation or not denied) else 0


def _exception(tokens: Sequence[Token], at: int) -> int:
    """Where a later part ends that spares a situation: ", but not in the bedroom", ", the study is the exception"."""
    if not at or not tokens[at].before or tokens[at].before == "?":
        return at
    end = next((k for k in range(at + 1, len(tokens)) if tokens[k].before), len(tokens))
    own = tokens[at:end]
    if any(token.any("when", "unless") for token in own):
        return at
    spared = any("spared" in token for token in own)
    limits = any(token.any("not") for token in own) and any(token.any("only", "but") for token in own)
    limits = limits or (own[0].any("not") and len(own) <= 5 and any(token.any("in", "through") for token in own))
    says = any(token.any(*SITUATIONS, *ROOMS, "times", "elsewhen") for token in own)
    bare = all(token.any(*_WHERE_AND_WHEN, "only", "but", "spared") for token in own)
    acts = any(token.any("into", "out", "away") for token in own)
    return end if says and bare and (spared or limits) and not acts else at


def _denied_before(rest: Sequence[Token], when: Token) -> int | None:
    """Where ", but not" begins that stands before a "when"; None: what is denied there is something else."""
    if when.before:
        return None
    at, denied = len(rest), False
    while at and rest[at - 1].any("not", "only", "but", "spared") and not rest[at - 1].any(*ROOMS):
        at -= 1
        denied = denied or "not" in rest[at]
        if rest[at].before:
            return at if denied else None
    others = any(token.any("only", "but") for token in rest[at:])
    return at if denied and others and at else None


_CONCEDING = known_words("auch selbst sogar even egal ob")

_BEING = known_words("sollte sollten steht kommt bin sind ist haben habe hab hat gibt muss pressierts pressiert eilts")

_SELVES = ("ich", "wir")

_NEAR_WHEN = ("bei",)

_WITH = known_words("with around among amid mit bei unter for in im at on under beim")

_PRESENT = known_words("present around about here there over anwesend da dabei")


def _is_turned_round(tokens: Sequence[Token], at: int, language: Language) -> bool:
    """German without a conjunction: "Sitze ich, ...", "Bin ich allein, dann ...", "Keiner da? Dann ..."."""
    begins = at == 0 or tokens[at].before in (".", "?")
    after = tokens[at + 1 :]
    ends = next((k for k, token in enumerate(after) if token.before), None)
    if language == "en" and begins and ends is not None and tokens[at].words[0].form == "should":
        return True  # "Should other people be there, ..."
    if language != "de" or not begins:
        return False
    if tokens[at].any(*POSTURES) and after and after[0].words[0].form in _SELVES:
        return True
    if ends is None:
        return False
    verb = tokens[at].words[0].form in _BEING
    asks = after[ends].before == "?" and any(one.any(*SITUATIONS) for one in tokens[at : at + 1 + ends])
    says = any(one.any(*SITUATIONS) for one in tokens[at : at + 1 + ends])
    then = "then" in after[ends]
    words = [word.form for token in tokens[at : at + 1 + ends] for word in token.words]
    inverted = len(words) > 1 and words[1] in _SUBJECTS and words[0] not in _MODALS and not words[0].endswith("st")
    inverted = inverted or (then and len(words) > 1 and words[1] in (*_SUBJECTS, "du", "sie"))
    return asks or (verb and says and after[ends].before == ",") or (inverted and after[ends].before == ",")


_SUBJECTS = ("ich", "wir", "es", "jemand", "niemand", "keiner", "man", "mein", "meine")

_MODALS = known_words("kann darf wuerde koennte haette moechte duerfte will mag bitte soll muss dass da so")


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
    if "no_hurry" in token:  # "no rush" is a wish
        return at > 0 and tokens[at - 1].words[0].form in _WITH
    return token.any("alone", "hurry", "times")


def _is_told(tokens: Sequence[Token], at: int) -> bool:
    own = segment(tokens, at)
    forms = [word.form for one in own for word in one.words]
    return any(form in _SELVES_SAID for form in forms) and not any("stay" in one for one in own[:2])


_SELVES_SAID = known_words("i we ive ich wir")


def _is_object(tokens: Sequence[Token], at: int) -> bool:
    """ "Keep away from guests", "hurry up": it is said what to do, not when."""
    if "hurry" in tokens[at]:
        return tokens[at].words[0].form not in _WITH and (at == 0 or tokens[at - 1].words[-1].form not in _WITH)
    before = [word.form for token in tokens[max(0, at - 2) : at] for word in token.words]
    return bool({"from", "to", "von", "vom", "zu", "den", "the", "annoy", "disturb"} & set(before)) or at == 0


def _end_of_clause(tokens: Sequence[Token], at: int, language: Language) -> int:
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
        end = _end_of_clause(tokens, end, language)
    if end < len(tokens):
        cut = (
            k
            for k in range(at + 3, end)
            if "stay" in tokens[k] and tokens[k].form in ORDERS and tokens[k - 1].form not in _DOERS
        )
        return next(cut, end) if language == "en" else end
    found = False
    for k in range(at + 1, end):
        says = tokens[k].any(*SITUATIONS, *ROOMS, *THINGS, "elsewhen", "me", "passing")
        clause = tokens[at + 1 : k]
        if found and "may" in tokens[k] and k + 1 < end and "notme" in tokens[k + 1]:
            return k  # "when I sit | may you ..."
        if found and tokens[k].form in _ADDRESSED and tokens[k - 1].form not in ("and", "or", "than", "with", "for"):
            return k  # "when I sit | you have to go slow"
        if found and tokens[k].form in (*NEARER, "rather"):
            return k
        if found and not says and not tokens[k].any("filler", "may", "in", "near", "into", "through", "not", "when"):
            further = any(one.any("stay", "not") or is_wish(one, language) for one in tokens[k + 1 : end])
            if tokens[k].any("stay", "away", "front", "behind", "between", "then") or is_wish(tokens[k], language):
                return k - 1 if "not" in tokens[k - 1] else k
            if further and not tokens[k].any("stay"):
                continue  # "when we're late for school | go fast"
            if not any(is_wish(one, language) for one in tokens[k:end]):
                return end  # "when I'm carrying something hot"
            return k
        says = says and not ("walking" in tokens[k] and "stay" in tokens[k] and tokens[k - 1].form not in _DOERS)
        if found and tokens[k].any("stay", "not") and not says:
            return k
        if "when" in tokens[k] and k > at + 1 and not tokens[k - 1].any("when", "unless"):
            return k
        orders = tokens[k].form in ORDERS or tokens[k].form.startswith(_DENYING)
        if not found and len(clause) > 1 and orders and tokens[k - 1].form not in _DOERS:
            return k  # "when I'm drawing | don't come so near"
        found = found or says
    return end


_ADDRESSED = known_words("you please kindly")

_DENYING = ("dont", "do not", "never")

_DOERS = known_words("i im you we were they it he she to ich du wir sie es er and und or oder")

_BEFORE_NOUNS = known_words("waehrend during")

_ARTICLES = known_words("the my our a der des dem meiner meines unserer")

_JOINING = known_words("and und or oder")


def read_conditions(span: Span) -> list[Condition]:
    """What must hold, of one stretch; none where nothing is known of it."""
    tokens = span.tokens
    found: list[Condition] = []
    postures = [token for k, token in enumerate(tokens) if token.any(*POSTURES) and not _is_robots(tokens, k)]
    nobody = any(token.form in _NOBODY for token in tokens)
    for at, token in enumerate(tokens):
        holds = _is_denied_there(tokens, at) == span.turned
        for kind in ("others", "hurry"):
            if kind in token:
                found.append(Condition(kind=kind, holds=holds))
        if "alone" in token:
            found.append(Condition(kind="others", holds=_is_denied_there(tokens, at) != span.turned))
        if "no_hurry" in token:
            found.append(Condition(kind="hurry", holds=span.turned))
        for kind in POSTURES:
            if kind in token and token in postures:
                found.append(Condition(kind=kind, holds=holds))
        room = next((one for one in ROOMS if one in token), None)
        thing = next((one for one in PIECES if one in token), None)
        if room and not (room == "doorway" and thing):
            found.append(Condition(kind="room", of=cast(RoomName, room), holds=holds))
        elif thing and not postures:
            found.append(Condition(kind="near", of=cast(Thing, thing), holds=holds))
        elif token.any("me", "passing") and any(one.any("near", "passing") for one in tokens) and not postures:
            found.append(Condition(kind="near", of="person", holds=holds))
    people = any(one.kind == "others" for one in found)
    if nobody and not postures and not people and not any(one.kind == "hurry" for one in found):
        found = [Condition(kind="others", holds=span.turned)]
    standing = [one for one in found if one.kind in POSTURES and one.holds]
    if len({one.kind for one in standing}) == 2:  # "standing or walking" is not sitting; "up and walking" walking
        either = any(token.form in ("or", "oder") for token in tokens)
        third = next(kind for kind in POSTURES if kind not in {one.kind for one in standing})
        found = [one for one in found if one not in standing]
        found.append(Condition(kind=third, holds=False) if either else standing[-1])
    if any(token.any("elsewhen", "times") for token in tokens) and not postures and not people:
        found = [one for one in found if one.kind not in ("room", "near")]
    if any(one.kind == "room" for one in found) and not any("passing" in token for token in tokens):
        found = [one for one in found if one.of != "person"]
    if any(one.kind == "near" and one.of != "person" for one in found):
        found = [one for one in found if one.of != "person"]
    kept: list[Condition] = []
    for one in found:
        if one not in kept and one.kind not in [other.kind for other in kept if other.kind != "room"]:
            kept.append(one)
    return kept


_NOBODY = known_words("niemand keiner nobody noone") | {"no one"}


def _is_denied_there(tokens: Sequence[Token], at: int) -> bool:
    """Whether what stands there must not be: denied in its own part between "and" and commas."""

    def parts(k: int) -> bool:
        both = k + 1 < len(tokens) and "others" in tokens[k - 1] and "others" in tokens[k + 1]  # "mum and dad"
        return tokens[k].before == "," or (tokens[k].form in ("and", "und") and not both)

    first = next((k for k in range(at, 0, -1) if parts(k)), 0)
    own = list(tokens[first : at + 1])
    for token in tokens[at + 1 :]:  # "aren't here"
        if token.before or (token.form in ("and", "und") and "others" not in tokens[at]) or token.any(*POSTURES):
            break
        own.append(token)
    return any("not" in token for token in own)


def only_passes(tokens: Sequence[Token]) -> bool:
    """ "When you come by", of nobody: where sides are wished it is always so."""
    passes = any(token.any("near", "passing") for token in tokens)
    return passes and all(token.any("when", "near", "passing", "filler", "may", "notme", "stay") for token in tokens)


_ROBOT = known_words("you it robot du er roboter dich es sie")


def _is_robots(tokens: Sequence[Token], at: int) -> bool:
    """ "When you move past the sofa"."""
    before = [word.form for token in tokens[:at] for word in token.words]
    return any(form in _ROBOT for form in before) and not any(form in ("i", "ich", "we", "wir") for form in before)


def placed_conditions(tokens: Sequence[Token], placed: Sequence[Token]) -> list[Condition]:
    found: list[Condition] = []
    for token in placed:
        own = segment(tokens, tokens.index(token))
        says_no_more = all(one.any("not", "only", "in", "through", "filler", "may", *ROOMS) for one in own)
        spared = (
            says_no_more and any("not" in one for one in own) and len(own) < len(tokens)
        )  # ", but not in the bedroom"
        for room in ROOMS:
            if room in token:
                found.append(Condition(kind="room", of=cast(RoomName, room), holds=not spared))
        for thing in PIECES:
            if thing in token and not token.any(*ROOMS):
                found.append(Condition(kind="near", of=cast(Thing, thing)))
        named = any(word.form in PERSONS for word in token.words)  # on which side goes without saying
        if "passing" in token and (named or not any(one.any("left", "right") for one in tokens)):
            found.append(Condition(kind="near", of="person"))
    return found
