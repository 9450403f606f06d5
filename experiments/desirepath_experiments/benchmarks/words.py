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
        labelled = []
        for row in csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE):
            wanted, _, lesser = row["said"].partition(">")
            objectives, less = (
                tuple(name.strip() for name in some.split(",") if name.strip()) for some in (wanted, lesser)
            )
            objectives = () if objectives[0] in ("nothing", "unclear") else objectives
            unknown = [objective for objective in (*objectives, *less) if objective not in NAMES]
            if unknown:
                raise ValueError(
                    f"{part}_{language}.tsv: {row['sentence']!r} has the label {unknown[0]!r}, no objective"
                )
            labelled.append(Labelled(row["case"], row["manner"], objectives, less, row["sentence"]))
        return labelled


def judge_sentences(sentences: Sequence[Labelled], understand: Callable[[str], Understood]) -> list[Judged]:
    """Every sentence as it is understood."""
    judgements = []
    for labelled in sentences:
        got = understand(labelled.sentence)
        silent = not labelled.said
        judgements.append(
            Judged(
                labelled,
                got,
                foremost=got.foremost == labelled.foremost if labelled.said else None,
                nothing=not got.weights if silent and labelled.case != "unclear" else None,
                above=_weighs_more(labelled, got) if labelled.lesser else None,
                asked=bool(got.questions),
            )
        )
    return judgements


def _weighs_more(labelled: Labelled, got: Understood) -> bool:
    preferred = got.weights.get(labelled.said[0], 0.0)
    return preferred > max(got.weights.get(name, 0.0) for name in labelled.lesser)


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
    both = [judgement for judgements in by_language.values() for judgement in judgements]
    everything: dict[str, list[Judged]] = {str(language_name): some for language_name, some in by_language.items()}
    everything |= {"both": both}
    return {
        "part": config.part,
        "sentences": {name: len(some) for name, some in everything.items()},
        "found": {name: _summarise(some) for name, some in everything.items()},
        "seconds_per_sentence": seconds,
    }


def _summarise(some: Sequence[Judged]) -> dict[str, Any]:
    wished = [judged for judged in some if judged.foremost is not None]
    silent = [judged for judged in some if judged.nothing is not None]
    unclear = [judged for judged in some if judged.labelled.case == "unclear"]
    pairs = [
        name not in judged.understood.weights
        for judged in some
        if judged.labelled.case != "unclear"
        for name in NAMES
        if name not in judged.labelled.said and name not in judged.labelled.lesser
    ]
    return {
        "foremost": _share([bool(judged.foremost) for judged in wished]),
        "foremost_or_offered": _share([bool(judged.foremost) or _is_offered(judged) for judged in wished]),
        "foremost_by_case": {
            case: _share([bool(judged.foremost) for judged in wished if judged.labelled.case == case]) for case in CASES
        },
        "negation_all": _share(
            [bool(judged.foremost or judged.nothing) for judged in some if judged.labelled.case == "negation"]
        ),
        "comparison_right_order": _share([bool(judged.above) for judged in some if judged.above is not None]),
        "nothing_said": _share([bool(judged.nothing) for judged in silent]),
        "nothing_said_off_topic": _share(
            [bool(judged.nothing) for judged in silent if judged.labelled.case == "nothing"]
        ),
        "objective_not_said_weighs_nothing": _share(pairs),
        "asked_back": _share([judged.asked for judged in some]),
        "unclear_asked_back": _share([judged.asked for judged in unclear]),
        "unclear_without_a_weight": _share([not judged.understood.weights for judged in unclear]),
        "foremost_by_manner": {
            manner: _share([bool(judged.foremost) for judged in wished if judged.labelled.manner == manner])
            for manner in sorted({judged.labelled.manner for judged in wished})
        },
    }


def _is_offered(judged: Judged) -> bool:
    """Asked back, and what was wanted is among what was offered."""
    if judged.understood.weights:
        return False
    return any(judged.labelled.foremost in question.offered for question in judged.understood.questions)


def _share(marks: Sequence[bool]) -> dict[str, Any]:
    return {"n": len(marks), "right": sum(marks), **asdict(wilson(sum(marks), len(marks)))} if marks else {"n": 0}
