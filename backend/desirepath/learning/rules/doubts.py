"""Sentences that name a place and order nothing: what need not be, what is allowed, what is denied twice."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

from desirepath.learning.rules.places import is_infinitive
from desirepath.learning.rules.rule import Zone
from desirepath.learning.rules.sentence import PIECES, ROOMS, SITUATIONS, THAT
from desirepath.learning.words.lexicon import Token, known_words


def is_no_order(tokens: Sequence[Token], zone: Zone, needless: Callable[[Sequence[Token]], bool]) -> bool:
    """Whether a part of the sentence that names the place of a zone only says that it may be otherwise, or cannot be
    read for sure. needless: whether a stretch says that something need not be."""
    parts = list(_parts(tokens))
    named = _named(zone)
    saying = [k for k, part in enumerate(parts) if any(token.any(*named) for token in part)]
    if not saying and zone.kind in ("front", "behind"):
        saying = [k for k, part in enumerate(parts) if any(token.any(*_SIDES) for token in part)]
    wholes = [_whole(parts, k) for k in saying]
    return any(needless(own) or _is_allowed(own) or _is_denied_twice(own, zone) for own in wholes)


_SIDES = ("front", "behind", "sight", "seen")


def _named(zone: Zone) -> tuple[str, ...]:
    if zone.kind in ("room", "thing"):
        return (str(zone.of),)
    return (zone.kind,)


def _parts(tokens: Sequence[Token]) -> Iterator[list[Token]]:
    """The tokens between punctuation, conjunctions and the beginnings of clauses."""
    own: list[Token] = []
    for token in tokens:
        begins = token.before or token.any("when", "unless", "but") or token.form in _JOINS
        if own and begins:
            yield own
            own = []
        own.append(token)
    if own:
        yield own


_JOINS = known_words("and und sondern")


def _whole(parts: Sequence[list[Token]], at: int) -> list[Token]:
    """A part with the one that it is said of: "I do not mind | if you ...", "dass du ..., | ist mir egal"."""
    own = parts[at]
    forms = [word.form for token in own for word in token.words]
    told = forms[0] in _TOLD or (forms[0] in _IF and len(forms) > 1 and forms[1] in _ROBOT)
    if at and (told or is_infinitive(forms)):
        return [*parts[at - 1], *own]
    return [*own, *parts[at + 1]] if told and at + 1 < len(parts) else own


_TOLD = THAT - {"so"} | known_words("ob whether")
_IF = known_words("wenn if when")
_ROBOT = known_words("du sie er der you it the")


def _is_allowed(own: Sequence[Token]) -> bool:
    return any("fine" in token for token in own) and not any(
        token.any("not", "bad", "only") and "fine" not in token for token in own
    )


def _is_denied_twice(own: Sequence[Token], zone: Zone) -> bool:
    """ "Do not stop driving behind me", "never leave the kitchen", "nothing is better than having you behind me"."""
    if zone.kind == "here":
        return False
    ends = [token.words[-1].form for token in own[1:]] + [""]
    denied = {
        token.form: token
        for token, after in zip(own, ends, strict=True)
        if token.any("not", "bad")
        and not token.any(*SITUATIONS)
        and (not token.form.startswith("stop") or after.endswith("ing"))
    }  # "never, never" is said once
    off = zone.kind in ("room", "thing") and any(
        token.any("out", "away") and token.form not in denied and not token.any(*ROOMS, *PIECES) for token in own
    )
    forms = [word.form for token in own for word in token.words]
    best = any(a in _BETTER for a in forms) and any(a in _THAN for a in forms)
    return len(denied) + off > 1 or (bool(denied) and best)


_BETTER = known_words("better nicer safer besser schoener lieber angenehmer sicherer")
_THAN = known_words("than als wie")


def ordering(tokens: Sequence[Token], text: str) -> list[Token]:
    """Tokens, of which German "musst du" complains only where it asks or behind "immer"; else it orders."""
    if text.rstrip().endswith("?"):
        return list(tokens)
    first = [not at or token.before in (".", "!", "?") for at, token in enumerate(tokens)]
    again = [False, *(token.form in _AGAIN for token in tokens)]
    return [
        replace(token, senses=frozenset({"filler"}))
        if "bad" in token and token.form.startswith(_MUST) and not (begins or always)
        else token
        for token, begins, always in zip(tokens, first, again[:-1], strict=True)
    ]


_AGAIN = known_words("immer staendig dauernd")
_MUST = ("musst du", "muessen sie")


def permitting(tokens: Sequence[Token]) -> list[Token]:
    """German "ruhig" that allows: "du darfst ruhig ...", "fahr ruhig hinter mir"; not "fahr ruhig"."""
    found: list[Token] = []
    for own in _parts(tokens):
        placed = any(token.any("front", "behind", "between", "into") for token in own)
        for before, token in pairwise(own):
            verb = before.words[-1].form
            if token.form == "ruhig" and (verb in _MAY or (placed and "stay" in before and verb not in _WISHED)):
                found.append(token)
    return found


_MAY = known_words("darf darfst duerfen kannst koennen koenntest")
_WISHED = known_words("dich sich fahren bleiben halten")
