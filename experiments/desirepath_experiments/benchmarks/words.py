"""`desirepath benchmark words`: labelled sentences of `datasets/words`, read and judged case by case.

Whoever wrote the lexicon has read both parts: what a reader does with others' sentences, they do not show; other files
of labelled sentences are measured by `tests/learning/words/measure.py`.
"""

from __future__ import annotations

import csv
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

import pydantic
from pydantic import Field

from desirepath.analysis.estimates import wilson
from desirepath.learning.preferences.objectives import NAMES
from desirepath.learning.words.lexicon import FOLDER, LANGUAGES, Language
from desirepath.learning.words.understanding import Understood, words_reader
from desirepath_experiments.benchmarks.results import Progress

CASES = ("plain", "several", "negation", "comparison")
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


def read_sentences(part: Part, language: Language) -> list[Labelled]:
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


def judge_sentences(sentences: Sequence[Labelled], understand: Callable[[str], Understood]) -> list[Judged]:
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
                above=_weighs_more(one, got) if one.lesser else None,
                asked=bool(got.questions),
            )
        )
    return found


def _weighs_more(one: Labelled, got: Understood) -> bool:
    preferred = got.weights.get(one.said[0], 0.0)
    return preferred > max(got.weights.get(name, 0.0) for name in one.lesser)


@pydantic.dataclasses.dataclass(frozen=True)
class WordsConfig:
    """Which sentences are read."""

    part: Annotated[Part, Field(description="test, or development (the only one to look at while tuning).")] = "test"


def benchmark_words(config: WordsConfig, progress: Progress | None = None) -> dict[str, Any]:
    """Shares with 95 % intervals (Wilson) by language and case; over both languages under `both`."""
    by_language: dict[Language, list[Judged]] = {}
    seconds: dict[str, float] = {}
    for language in LANGUAGES:
        reader, sentences = words_reader(language), read_sentences(config.part, language)
        reader.understand(sentences[0].sentence)  # what is loaded once is not measured
        began = time.perf_counter()
        by_language[language] = judge_sentences(sentences, reader.understand)
        seconds[language] = (time.perf_counter() - began) / len(sentences)
    both = [one for judgements in by_language.values() for one in judgements]
    everything: dict[str, list[Judged]] = {str(one): some for one, some in by_language.items()}
    everything |= {"both": both}
    return {
        "part": config.part,
        "sentences": {name: len(some) for name, some in everything.items()},
        "found": {name: _summarise(some) for name, some in everything.items()},
        "seconds_per_sentence": seconds,
    }


def _summarise(some: Sequence[Judged]) -> dict[str, Any]:
    wished = [one for one in some if one.foremost is not None]
    silent = [one for one in some if one.nothing is not None]
    unclear = [one for one in some if one.labelled.case == "unclear"]
    pairs = [
        name not in one.understood.weights
        for one in some
        if one.labelled.case != "unclear"
        for name in NAMES
        if name not in one.labelled.said and name not in one.labelled.lesser
    ]
    return {
        "foremost": _share([bool(one.foremost) for one in wished]),
        "foremost_or_offered": _share([bool(one.foremost) or _offered(one) for one in wished]),
        "foremost_by_case": {
            case: _share([bool(one.foremost) for one in wished if one.labelled.case == case]) for case in CASES
        },
        "negation_all": _share([bool(one.foremost or one.nothing) for one in some if one.labelled.case == "negation"]),
        "comparison_right_order": _share([bool(one.above) for one in some if one.above is not None]),
        "nothing_said": _share([bool(one.nothing) for one in silent]),
        "nothing_said_off_topic": _share([bool(one.nothing) for one in silent if one.labelled.case == "nothing"]),
        "objective_not_said_weighs_nothing": _share(pairs),
        "asked_back": _share([one.asked for one in some]),
        "unclear_asked_back": _share([one.asked for one in unclear]),
        "unclear_without_a_weight": _share([not one.understood.weights for one in unclear]),
        "foremost_by_manner": {
            manner: _share([bool(one.foremost) for one in wished if one.labelled.manner == manner])
            for manner in sorted({one.labelled.manner for one in wished})
        },
    }


def _offered(one: Judged) -> bool:
    """Asked back, and what was wanted is among what was offered."""
    if one.understood.weights:
        return False
    return any(one.labelled.foremost in question.offered for question in one.understood.questions)


def _share(given: Sequence[bool]) -> dict[str, Any]:
    return {"n": len(given), "right": sum(given), **asdict(wilson(sum(given), len(given)))} if given else {"n": 0}
