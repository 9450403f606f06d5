"""What the parts of the rules' reader share: a sentence's tokens, its parts, and which words wish something."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import cast, get_args

from desirepath.learning.rules.rule import RoomName, Thing
from desirepath.learning.words.clauses import HEADS
from desirepath.learning.words.lexicon import Language, Token, known_words, lexicon

ROOMS, THINGS = cast(tuple[str, ...], get_args(RoomName)), cast(tuple[str, ...], get_args(Thing))

PIECES = tuple(thing for thing in THINGS if thing != "person")

POSTURES = ("sitting", "standing", "walking")

SIDES = ("person_on_left", "person_on_right")

SITUATIONS = (*POSTURES, "others", "alone", "hurry", "no_hurry")

MOST_BETWEEN = 3  # words from `in` to the room, from `near` to the thing

ORDERS = known_words("komm fahr bleib halt geh mach lass nimm sei bitte keep stay go come drive please give move take")


def is_wish(token: Token, language: Language) -> bool:
    """Whether it is a word of what may be wished."""
    return any(
        one.any(*HEADS) and not one.any("filler", "may")
        for form in [token.form]
        for one in words_tokens(form, language)
    )


@lru_cache(maxsize=5_000)
def words_tokens(form: str, language: Language) -> tuple[Token, ...]:
    return tuple(lexicon(language).tokens(form))


def segment(tokens: Sequence[Token], at: int) -> list[Token]:
    """The tokens between the punctuation around one of them."""
    first = next((k for k in range(at, 0, -1) if tokens[k].before), 0)
    last = next((k for k in range(at + 1, len(tokens)) if tokens[k].before), len(tokens))
    return list(tokens[first:last])


NEARER = known_words("closer nearer tighter enger knapper naeher dichter weiter farther further")

PERSONS = known_words("me mir mich us uns")

THAT = known_words("dass that so sodass")


def part(tokens: Sequence[Token], at: int) -> tuple[int, int]:
    """Where the part between punctuation and "and" begins and ends that a token stands in."""

    def begins(k: int) -> bool:
        return (
            bool(tokens[k].before) or tokens[k].form in ("and", "und") or tokens[k - 1].form.endswith((" and", " und"))
        )

    first = next((k for k in range(at, 0, -1) if begins(k)), 0)
    last = next((k for k in range(at + 1, len(tokens)) if begins(k)), len(tokens))
    return first, last
