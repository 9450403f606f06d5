"""`desirepath benchmark words`: how well labelled sentences are understood, case by case.

Whoever wrote the lexicon has read both parts: what a reader does with others' sentences, they do not show.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from desirepath.analysis.estimates import wilson
from desirepath.learning.preferences.objectives import NAMES
from desirepath.learning.words.lexicon import LANGUAGES, Language
from desirepath.learning.words.understanding import words_reader
from desirepath_experiments.benchmarks.word_judging import Judged, Part, judged, labelled_sentences

CASES = ("plain", "several", "negation", "comparison")


def benchmark_words(part: Part = "test") -> dict[str, Any]:
    """Shares with 95 % intervals (Wilson) by language and case; over both languages under `both`."""
    by_language: dict[Language, list[Judged]] = {}
    seconds: dict[str, float] = {}
    for language in LANGUAGES:
        reader, sentences = words_reader(language), labelled_sentences(part, language)
        reader.understand(sentences[0].sentence)  # what is loaded once is not measured
        began = time.perf_counter()
        by_language[language] = judged(sentences, reader.understand)
        seconds[language] = (time.perf_counter() - began) / len(sentences)
    both = [one for judgements in by_language.values() for one in judgements]
    everything: dict[str, list[Judged]] = {str(one): some for one, some in by_language.items()}
    everything |= {"both": both}
    return {
        "part": part,
        "sentences": {name: len(some) for name, some in everything.items()},
        "found": {name: _found(some) for name, some in everything.items()},
        "seconds_per_sentence": seconds,
    }


def _found(some: Sequence[Judged]) -> dict[str, Any]:
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
