"""A second reader of wishes, which only doubts: what the rules read and it finds otherwise is asked back.

A linear classifier of hashed n-grams per scale, whose classes are one end, the other end and nothing said. It is
trained by `desirepath ship words-veto`; here it is a sum over the n-grams of a sentence.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Self
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from desirepath.learning.errors import LearningError
from desirepath.learning.words.lexicon import FOLDER, Language, Token, lexicon, words_of
from desirepath.learning.words.readings import OPPOSITE, SIDES
from desirepath.npz import Arrays
from desirepath.simulation.stored import StoredArrays

Wish = tuple[str, bool]
"""An objective, and whether more of it is wished."""

BUCKETS = 2**14
ENDS: tuple[tuple[Wish, Wish], ...] = (
    (("farther", True), ("closer", True)),
    *(((name, True), (name, False)) for name in ("clearance", "shorter", "smoother", "faster", "slower_near_person")),
    ((SIDES[0], True), (SIDES[1], True)),
)
_PLACES: Mapping[Wish, int] = {wish: place for place, wish in enumerate(wish for ends in ENDS for wish in ends)}
OTHER_END, NOTHING_SAID = 0.5, 2.5
"""How much more probable (difference of log probabilities) the other end, or nothing, has to be than what was read:
chosen on sets of sentences and the readers of before they were tuned by these (experiments/notebook)."""
_LONGEST_PAIR = 4  # tokens from one to the other


def one_end(objective: str, wanted: bool) -> Wish:
    """Less of "closer" is "farther": both are one scale."""
    return (OPPOSITE[objective], True) if not wanted and objective in OPPOSITE else (objective, wanted)


def other_end(wish: Wish) -> Wish:
    """The contrary of a wish, as `one_end` gives it."""
    return next(ends[1 - ends.index(wish)] for ends in ENDS if wish in ends)


def hash_features(text: str, tokens: Sequence[Token], language: Language) -> dict[int, float]:
    """Bucket -> value: n-grams of words, of letters and of senses, and pairs of senses near each other. Each of the
    four has length 1; linear in the text."""
    words = [word.form for word in words_of(text, language)]
    senses = [one.form if "unknown" in one else "+".join(sorted(one.senses)) for one in tokens]
    telling = [one for one in senses if one != "filler"]
    found: dict[int, float] = {}
    for kind in (
        _grams("w", words),
        (
            f"c{padded[k : k + n]}"
            for padded in map(" {} ".format, words)
            for n in (3, 4, 5)
            for k in range(len(padded) - n + 1)
        ),
        _grams("s", senses),
        (f"k{a}|{b}" for k, a in enumerate(telling) for b in telling[k + 1 : k + 1 + _LONGEST_PAIR]),
    ):
        counts = Counter(crc32(gram.encode()) % BUCKETS for gram in kind)
        values = {bucket: 1 + math.log(count) for bucket, count in counts.items()}
        length = math.hypot(*values.values())
        for bucket, value in values.items():
            found[bucket] = found.get(bucket, 0.0) + value / length
    return found


def _grams(kind: str, items: Sequence[str]) -> Iterator[str]:
    return (kind + " ".join(items[k : k + n]) for n in (1, 2, 3) for k in range(len(items) - n + 1))


@dataclass(frozen=True)
class Doubts:
    """Wishes that would not have been read in a text: turned, because their other end is more probable; unsaid, because
    nothing is said of them."""

    turned: frozenset[Wish]
    unsaid: frozenset[Wish]


@dataclass(frozen=True)
class SecondReader(StoredArrays):
    """weights: (BUCKETS, 2 * len(ENDS)) int8, in units of `scales` (2 * len(ENDS),): by how much a feature makes an end
    more probable than that nothing is said of its scale; intercepts: the same without any feature."""

    noun: ClassVar[str] = "second reader"
    raises: ClassVar[type[ValueError]] = LearningError
    file_format: ClassVar[str] = "desirepath-second-reader-1"

    language: Language
    weights: NDArray[np.int8]
    scales: NDArray[np.float32]
    intercepts: NDArray[np.float32]

    def log_odds(self, text: str, tokens: Sequence[Token]) -> NDArray[np.float32]:
        """(len(ENDS), 2): of each end of each scale, against nothing being said of it."""
        features = hash_features(text, tokens, self.language)
        values = np.fromiter(features.values(), np.float32, len(features))
        summed = values @ self.weights[list(features)].astype(np.float32)
        return (summed * self.scales + self.intercepts).reshape(len(ENDS), 2)

    def doubts(self, text: str, tokens: Sequence[Token]) -> Doubts:
        odds = self.log_odds(text, tokens)
        turned, unsaid = (odds[:, ::-1] - odds).ravel() > OTHER_END, -odds.ravel() > NOTHING_SAID
        return Doubts(*(frozenset(wish for wish, k in _PLACES.items() if over[k]) for over in (turned, unsaid)))

    def to_parts(self) -> tuple[dict[str, object], Arrays]:
        arrays: Arrays = {"weights": self.weights, "scales": self.scales, "intercepts": self.intercepts}
        return {"language": self.language}, arrays

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> Self:
        return cls(header["language"], arrays["weights"], arrays["scales"], arrays["intercepts"])


def reader_file(language: Language, folder: Path = FOLDER) -> Path:
    return folder / f"second_reader_{language}.npz"


@lru_cache(maxsize=2)
def second_reader(language: Language) -> SecondReader:
    """The shipped one."""
    return SecondReader.load(reader_file(language))


def features_of(text: str, language: Language) -> dict[int, float]:
    """As `hash_features`, of a text whose tokens nobody has yet."""
    return hash_features(text, lexicon(language).tokens(text), language)
