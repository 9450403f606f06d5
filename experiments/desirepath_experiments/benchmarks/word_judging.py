"""How well sentences are understood: labelled ones of `datasets/words`, read and judged case by case.

How other files of labelled sentences are measured: `tests/learning/words/measure.py`.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from desirepath.learning.preferences.objectives import NAMES
from desirepath.learning.words.lexicon import FOLDER, Language
from desirepath.learning.words.understanding import Understood

Part = Literal["test", "development"]


@dataclass(frozen=True)
class Labelled:
    """said: what is wanted, foremost first; lesser: what is said to matter less. Both empty: nothing is said about
    driving, or, where `case` is `unclear`, nothing that can be told without asking back.
    """

    case: str
    manner: str
    said: tuple[str, ...]
    lesser: tuple[str, ...]
    sentence: str

    @property
    def foremost(self) -> str | None:
        return self.said[0] if self.said else None


@dataclass(frozen=True)
class Judged:
    """One sentence: whether the foremost objective is right (None where there is none); of nothing said, whether no
    weight was set; of a comparison, whether the preferred weighs more; whether something was asked back.
    """

    labelled: Labelled
    understood: Understood
    foremost: bool | None
    nothing: bool | None
    above: bool | None
    asked: bool


def labelled_sentences(part: Part, language: Language) -> list[Labelled]:
    """The sentences of that part. Raises ValueError for a label that is no objective."""
    with (FOLDER / f"{part}_{language}.tsv").open(encoding="utf-8", newline="") as file:
        found = []
        for row in csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE):
            wanted, _, lesser = row["said"].partition(">")
            said, less = (tuple(one.strip() for one in some.split(",") if one.strip()) for some in (wanted, lesser))
            said = () if said[0] in ("nothing", "unclear") else said
            unknown = [one for one in (*said, *less) if one not in NAMES]
            if unknown:
                raise ValueError(
                    f"{part}_{language}.tsv: {row['sentence']!r} has the label {unknown[0]!r}, no objective"
                )
            found.append(Labelled(row["case"], row["manner"], said, less, row["sentence"]))
        return found


def judged(sentences: Sequence[Labelled], understand: Callable[[str], Understood]) -> list[Judged]:
    """Every sentence as it is understood."""
    found = []
    for one in sentences:
        got = understand(one.sentence)
        silent = not one.said
        found.append(
            Judged(
                one,
                got,
                foremost=got.foremost == one.foremost if one.said else None,
                nothing=not got.weights if silent and one.case != "unclear" else None,
                above=_above(one, got) if one.lesser else None,
                asked=bool(got.questions),
            )
        )
    return found


def _above(one: Labelled, got: Understood) -> bool:
    preferred = got.weights.get(one.said[0], 0.0)
    return preferred > max(got.weights.get(name, 0.0) for name in one.lesser)
