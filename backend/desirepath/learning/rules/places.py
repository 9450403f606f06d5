"""Where a robot must not be, and on whose side: zones and sides that a rule names."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, cast

from desirepath.learning.rules.rule import RoomName, Thing, Wish, Zone
from desirepath.learning.rules.sentence import (
    MOST_BETWEEN,
    NEARER,
    PERSONS,
    PIECES,
    ROOMS,
    SIDES,
    THAT,
    is_wish,
    part,
    segment,
    words_tokens,
)
from desirepath.learning.rules.situations import Span
from desirepath.learning.words.lexicon import Language, Token, known_words


def is_kept_from_inside(rest: Sequence[Token]) -> bool:
    goes = any(token.any("into", "out") or token.form in _INSIDE for token in rest)
    return goes and any("not" in token for token in rest)


_INSIDE = known_words("in inside rein hinein herein drin")


def complained_of(spans: Sequence[Span], rest: Sequence[Token], tokens: Sequence[Token]) -> Zone | None:
    """ "When you drive behind me, I get nervous": a place where it must not be, told as what happens."""
    number = {id(token): sum(bool(one.before) for one in tokens[1 : k + 1]) for k, token in enumerate(tokens)}
    bad = [number[id(token)] for token in rest if "bad" in token]
    for span in spans:
        for token in span.tokens:
            if token.any("front", "behind") and any(abs(number[id(token)] - one) <= 1 for one in bad):
                return Zone(kind="front" if "front" in token else "behind")
    return None


def allowed_only(rest: Sequence[Token], spans: Sequence[Span]) -> Zone | None:
    """ "Behind me only when I sit" forbids it at all other times."""
    token = next((one for one in rest if one.any("front", "behind")), None)
    denied = [k for k, one in enumerate(rest) if one.any("not", "bad")]
    denied = [k for k in denied if not any(one.form in _ELSE for one in segment(rest, k))]
    only = any("only" in one for one in rest) and bool(spans) and not denied
    own = [] if token is None else segment(rest, rest.index(token))
    if token is None or not only or any("stay" in one and not any("may" in other for other in own) for one in own):
        return None
    return Zone(kind="front" if "front" in token else "behind")


_ELSE = known_words("sonst ansonsten otherwise else")


def find_zones(tokens: Sequence[Token]) -> tuple[list[Zone], list[Token], list[Token]]:
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
        return [Zone(kind="between", of=cast(Thing, thing))], rooms, [*segment(tokens, between), *rooms]
    either = {sense for token in tokens for sense in ("front", "behind") if sense in token}
    contrast = _contrasted(tokens) if len(either) == 2 else None
    if contrast is not None:
        return contrast, placed, list(tokens)
    for sense, kept in (("sight", "front"), ("seen", "behind"), ("behind", "front"), ("front", "behind")):
        at = next((k for k, token in enumerate(tokens) if sense in token), None)
        if at is None:
            continue
        denied = _is_denied(tokens, at)
        own = tokens[slice(*part(tokens, at))]
        clear = sense != "front" or not any(one.any("unknown", "away", "out", "into") for one in own)
        allowed = any(one.any("may") for one in own) or _is_doubtful(tokens, at)  # "you may drive behind me"
        if not denied and (allowed or not (clear and any("stay" in token for token in own))):
            continue  # nothing says that it should be there
        contrary = {"behind": "behind", "front": "front", "sight": "behind", "seen": "front"}
        kind = contrary[sense] if denied else kept
        first, last = part(tokens, at)
        used = [*_where(tokens, placed, away=False), *tokens[first:last]]
        return [Zone(kind=kind)], placed, used
    target = _kept_from(tokens) or _not_neared(tokens)
    if target is not None and target.any(*PIECES) and not _is_of_furniture(tokens, target):
        of = cast(Thing, next(one for one in PIECES if one in target))
        used = segment(tokens, tokens.index(target))
        used += [one for k, two in enumerate(tokens) if "away" in two for one in segment(tokens, k) if one not in used]
        others = [one for one in placed if one is not target]
        return [Zone(kind="thing", of=of)], others, [*used, *_where(tokens, others, away=False)]
    if target is not None and target.any(*PIECES):  # "more distance to the chairs"
        placed = [one for one in placed if one is not target]
    rooms = [token for token in placed if token.any(*ROOMS) and not token.any(*PIECES)]
    into = any(_is_denied(tokens, k) for k, token in enumerate(tokens) if "into" in token)
    if rooms and (_is_kept_out(tokens, rooms[0]) or into or (target is not None and target in rooms)):
        of_room = cast(RoomName, next(one for one in ROOMS if one in rooms[0]))
        return [Zone(kind="room", of=of_room)], [], segment(tokens, tokens.index(rooms[0]))
    return (
        [],
        placed,
        _where(tokens, placed, away=target is not None or any(one.any(*ROOMS) or one.form in NEARER for one in tokens)),
    )


def _contrasted(tokens: Sequence[Token]) -> list[Zone] | None:
    """ "Not in front of me but behind me", "statt hinter mir lieber vor mir": what is denied of both; None: neither."""
    first, second = [k for k, token in enumerate(tokens) if token.any("front", "behind")][:2]
    before = tokens[part(tokens, first)[0] : first]
    between = tokens[first + 1 : second]
    kinds: list[Literal["front", "behind"]] = ["front" if "front" in tokens[k] else "behind" for k in (first, second)]
    turned, turns = _turns(before), _turns(between)
    if turned and not turns and any(one.form in _EITHER for one in between):
        return [Zone(kind=kind) for kind in kinds]
    forms = [word.form for one in between for word in one.words]
    if not turned and not turns and {*forms} & {*_THAN}:  # "rather behind me than in front of me"
        if not {word.form for one in before for word in one.words} & {*_PREFERRED} and not {*forms} & {*_PREFERRED}:
            return []
        turns = True
    return [Zone(kind=kinds[0 if turned else 1])] if turned != turns else None


def _turns(own: Sequence[Token]) -> bool:
    """Whether it denies what comes behind it."""
    forms = [word.form for one in own for word in one.words]
    instead = any(form in _INSTEAD for form in forms) or ("rather", "than") in pairwise(forms)
    return instead or any("not" in one for one in own)


_INSTEAD = known_words("statt anstatt instead")
_THAN = known_words("than als over")
_PREFERRED = known_words(
    "rather prefer lieber eher besser better nicer safer angenehmer schoener sicherer bevorzuge mehr more"
)
_EITHER = known_words("or nor oder noch")


def _is_doubtful(tokens: Sequence[Token], at: int) -> bool:
    """Whether another part of the sentence denies or dislikes without saying what: no order is sure beside that."""
    first, last = part(tokens, at)
    parts = {part(tokens, k) for k, token in enumerate(tokens) if token.any("not", "bad") and not first <= k < last}
    return any(not any(one.any("stay", "front", "behind") for one in tokens[a:b]) for a, b in parts)


def _not_neared(tokens: Sequence[Token]) -> Token | None:
    """The thing that "don't go near the lamp", "nicht so nah an die Säule" is said of."""
    for at, token in enumerate(tokens):
        own, before = segment(tokens, at), tokens[max(0, at - MOST_BETWEEN) : at]
        said = any("near" in one for one in before) and any("not" in one for one in own)
        wished = any(one.any("unknown", "me", "front", "behind") and one.form not in _SMALL for one in own)
        if token.any(*PIECES) and said and not wished:
            return token
    return None


_SMALL = known_words("me mir so too zu anywhere nah nahe close dicht ganz")


def _is_of_furniture(tokens: Sequence[Token], target: Token) -> bool:
    """Walls, furniture and "more distance" are wished of everything that stands about."""
    own = segment(tokens, tokens.index(target))
    return any(one.any("furniture", "wall") or one.form in _MORE for one in own)


_MORE = known_words("more mehr bigger larger groesseren groesserer extra wider") | {"a bit", "ein bisschen", "a little"}


def _is_kept_out(tokens: Sequence[Token], room: Token) -> bool:
    """ "Out of the kitchen", "die Küche ist tabu"; not "I beg of you (bitt ich mir aus) that ..."."""
    at = tokens.index(room)
    before = tokens[max(0, at - MOST_BETWEEN) : at]
    own = segment(tokens, at)
    return any("out" in token for token in before) or any("out" in one and one.form not in _OUT_OF for one in own)


def _is_denied(tokens: Sequence[Token], at: int) -> bool:
    """Whether what stands there must not be: by its own part of the sentence, else by another."""
    first, last = part(tokens, at)
    own = tokens[first:last]
    bare = is_infinitive([word.form for one in own for word in one.words]) and not any(
        one.any("not", "bad") for one in own
    )
    if not first and own[0].words[0].form in THAT and last < len(tokens):  # "that you drive there, I dislike"
        own = [*own, *tokens[slice(*part(tokens, last))]]
    if first and (own[0].words[0].form in THAT or bare):  # "I do not want that you ..."
        own = [*tokens[slice(*part(tokens, first - 1))], *own]
    if any("not" in token for token in own):
        return not any("bad" in token for token in own)
    if any("bad" in token for token in own):
        return True
    return not any("stay" in token for token in own) and any(token.any("not", "bad") for token in tokens)


def _kept_from(tokens: Sequence[Token]) -> Token | None:
    """What "keep away from" is said of, where it is a thing or a room: of the person it is a wish."""
    for at, token in enumerate(tokens):
        if "away" not in token or (token.form == "weg" and at and _is_of_way(tokens[at - 1])):
            continue
        after = next((one for one in tokens[at + 1 : at + 5] if one.any("me", *PIECES, *ROOMS)), None)
        if after is not None:
            return None if "me" in after and not after.any(*PIECES, *ROOMS) else after
        for k in range(at - 1, max(at - 6, -1), -1):  # "vom Sofa fern"
            if tokens[k].any(*PIECES, *ROOMS):
                own = tokens[max(k - 2, 0) : k]
                return tokens[k] if any(word.form in _FROM for one in own for word in one.words) else None
    return None


def _is_of_way(token: Token) -> bool:
    """German "den kürzesten Weg"."""
    return any(one.any("short", "long", "way") for one in words_tokens(token.form, "de"))


_OUT_OF = ("aus", "out", "out of")

_PAST = known_words("vorbei vorueber entlang lang herum past by along")

_TIGHT = ("dicht", "eng", "nah", "knapp", "close", "tight", "hug", "schrapp")

_STAYS = known_words("stay keep remain be bleib bleibe bleiben halt halte sei come komm")
_MINDING = ("kuemmer", "mind", "acht", "ruecksicht", "sorg", "worry", "care")
_DETERMINERS = known_words(
    "the a an my our your this that its his her der die das den dem des ein eine einen einem einer mein meine meinen "
    "meinem meiner unser unsere unserem unserer unseren dein deine deinem deiner direkt gleich of am im zum zur old"
)

_FROM = known_words("von vom zu zur zum from to der dem den um ums")


def _where(tokens: Sequence[Token], placed: Sequence[Token], away: bool) -> list[Token]:
    """Tokens that say where and not what: "in the kitchen", "near the sofa"; not "away from the walls"."""
    found: list[Token] = []
    for at, token in enumerate(tokens):
        beside = at > 0 and tokens[at - 1].form in _BESIDE
        if token not in placed or (token.any("furniture", "wall") and not beside and (away or _is_hugged(tokens, at))):
            continue
        found.append(token)
        for before in reversed(tokens[max(0, at - MOST_BETWEEN) : at]):
            article = "filler" in before and before.form in _DETERMINERS
            if not article and not before.any("near", "in", "through", "into"):
                break
            found.append(before)
        found += [after for after in tokens[at + 1 : at + 3] if after.form in _PAST]  # "am Sofa vorbei"
    return found


def _is_hugged(tokens: Sequence[Token], at: int) -> bool:
    """ "Eng an der Wand", "close to the furniture" is what is wished, not where."""
    before = [word.form for token in tokens[max(0, at - MOST_BETWEEN - 1) : at] for word in token.words]
    tight = any(form.startswith((*_TIGHT, *_MINDING)) for form in before)
    first, last = part(tokens, at)
    return tight and not any(one.form in PERSONS for one in tokens[first:last])


_BESIDE = known_words("neben bei near beside nearby") | {"next to", "close to"}


def _placed(tokens: Sequence[Token]) -> list[Token]:
    """Tokens of rooms, and of things that stand behind a word of place."""
    found: list[Token] = []
    for at, token in enumerate(tokens):
        before = tokens[max(0, at - MOST_BETWEEN) : at]
        if token.any(*PIECES):
            if any(one.any("near", "in", "through") for one in before) or token is _kept_from(tokens):
                found.append(token)
        elif "passing" in token and at and tokens[at - 1].form in _STAYS:
            continue  # "stay near me" is a wish
        elif token.any("passing", *ROOMS):
            found.append(token)
    return found


def forbidden(tokens: Sequence[Token], placed: Sequence[Token], unsure: bool, language: Language) -> list[Zone]:
    """What "not ..." forbids where nothing else is wished: a room, a thing, a place that is pointed at."""
    known = (
        "not",
        "away",
        "out",
        "stay",
        "filler",
        "may",
        "in",
        "into",
        "near",
        "through",
        "here",
        "only",
        *ROOMS,
        *PIECES,
    )
    denied = any(token.any("not", "away", "out") for token in tokens)
    if unsure or not denied or not all(token.any(*known) for token in tokens):
        return []
    for token in placed:
        for room in ROOMS:
            if room in token:
                return [Zone(kind="room", of=cast(RoomName, room))]
        for thing in PIECES:
            if thing in token and thing not in ("furniture", "wall"):
                return [Zone(kind="thing", of=cast(Thing, thing))]
    return []


def pointed_at(tokens: Sequence[Token], language: Language) -> list[Token]:
    """The part that forbids a place that is pointed at: "not over there", "in der Ecke da hast du nichts verloren"."""
    for at, token in enumerate(tokens):
        own = segment(tokens, at)
        pointing = len(token.words) > 1 or (
            any("not" in one for one in own) and not (token.form == "da" and token.before)
        )
        wished = any(
            is_wish(one, language) and not one.any("not", "away", "here") and one.form != "lang" for one in own
        )
        if "here" in token and pointing and any(one.any("not", "away", "out") for one in own) and not wished:
            return (
                []
                if any(one.any(*ROOMS, *PIECES, "me", "front", "behind") and one.form not in PERSONS for one in own)
                else own
            )
    return []


def read_side(tokens: Sequence[Token]) -> tuple[Wish, list[Token]] | None:
    """The robot's side on which the person is to be: "keep me on your left", "dass du mich rechts hast"; and the tokens
    that it is read of. None where it is not clear whose side it is."""
    for at, token in enumerate(tokens):
        if not token.any("left", "right"):
            continue
        first, last = part(tokens, at)
        own = list(tokens[first:last])
        forms = [word.form for one in own for word in one.words]
        theirs = _is_theirs(forms)
        person = any(form in _ME for form in forms)
        held = any(form in _OBJECT for form in forms) and any(form in _HAVING for form in forms)
        if not person or any(form in _MINE for form in forms) or not (theirs or held):
            continue
        used = own
        denied = _is_turned(own)
        if not denied and first:  # "not so | that I am on your left", "ich mag es nicht, | links von dir zu sein"
            before = list(tokens[part(tokens, first - 1)[0] : first])
            if (own[0].words[0].form in THAT or is_infinitive(forms)) and _is_turned(before):
                denied, used = True, before + own
        name = SIDES[0] if ("left" in token) != denied else SIDES[1]
        return Wish(objective=name), used
    return None


def _is_turned(own: Sequence[Token]) -> bool:
    """Denied or disliked, not both."""
    return any("not" in one for one in own) != any("bad" in one for one in own)


def is_infinitive(forms: Sequence[str]) -> bool:
    """ "Dich hinter mir zu haben", "to have you behind me", "being on your left"; not "zu nah"."""
    after = any((a == "zu" and b.endswith("n")) or (a == "to" and b in _STATES) for a, b in pairwise(forms))
    return after or any(form in ("being", "having") for form in forms)


_STATES = known_words("be have get see find know stand walk sit")

_ME = known_words("me i im ich mich mir us uns person mit be sein bin")

_OBJECT = known_words("me mich us uns")

_MINE = known_words("my our mein meine meinen meiner meinem unserer unsere")

_HAVING = known_words("hast hab habe haben halt halte halten behalt behalte lass lassen have keep having keeping leave")

_THEIRS = known_words("your deiner deine deinem deinen dein ihrer ihre ihrem ihren its")


def _is_theirs(forms: Sequence[str]) -> bool:
    of_you = any(a in ("von", "of", "neben") and b in ("dir", "ihnen", "you") for a, b in pairwise(forms))
    return of_you or any(form in _THEIRS for form in forms)
