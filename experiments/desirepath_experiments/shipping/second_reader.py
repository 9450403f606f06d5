"""The second reader of words: trained on all labelled sentences, measured by leaving out one set after the other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, diags
from sklearn.linear_model import LogisticRegression

from desirepath.installed import ROOT
from desirepath.learning.cards import Card, file_sha256
from desirepath.learning.shipping.storing import Request, store
from desirepath.learning.words.lexicon import LANGUAGES, Language
from desirepath.learning.words.second_reader import (
    BUCKETS,
    ENDS,
    NOTHING_SAID,
    OTHER_END,
    SecondReader,
    features_of,
    reader_file,
)
from desirepath.learning.words.understanding import WordsReader
from desirepath_experiments.benchmarks.labelled_wishes import Case, judge, read_cases

SENTENCES = ROOT / "tests" / "learning" / "words"
UNSEEN = "unseen"  # sets that nothing was fitted to
PENALTY = 10.0  # scikit-learn's C
_HONEST = (
    "Whether it helps was measured on sets of others' sentences with the readers of before they were tuned by these, "
    "and with second readers that had seen neither the set nor ours written because of it: experiments/notebook."
)


def ship_words_veto(request: Request, sentences: Path = SENTENCES) -> list[Card]:
    """Train and store `words/second_reader_LANGUAGE.npz`, both with a card; a minute of one core."""
    return [_ship(language, request.folder, sentences) for language in LANGUAGES]


def _ship(language: Language, folder: Path, sentences: Path) -> Card:
    files = sorted(file for file in sentences.glob(f"*_{language}.csv*") if not file.name.startswith(UNSEEN))
    sets = [read_cases(file) for file in files]
    if not sets:
        raise ValueError(f"{sentences} has no *_{language}.csv; it is tests/learning/words of a checkout")
    return store(
        "second_reader",
        f"words/{reader_file(language, folder).stem}",
        fit_second_reader([case for cases in sets for case in cases], language).save,
        folder,
        command="desirepath ship words-veto",
        config={"buckets": BUCKETS, "penalty": PENALTY, "other_end": OTHER_END, "nothing_said": NOTHING_SAID},
        results={"left_out": _measure_left_out(files, sets, language)},
        parents={file.name: file_sha256(file) for file in files},
        notes=["The rules were tuned by the sets that are left out here, so this shows what doubting costs.", _HONEST],
    )


def fit_second_reader(cases: Sequence[Case], language: Language) -> SecondReader:
    """Logistic regression per scale; a sentence to be asked back says nothing for certain."""
    features_of_cases = [features_of(case.sentence, language) for case in cases]
    rows = np.repeat(np.arange(len(cases)), [len(case_features) for case_features in features_of_cases])
    columns = np.array([bucket for case_features in features_of_cases for bucket in case_features])
    values = np.array([value for case_features in features_of_cases for value in case_features.values()])
    features = csr_matrix((values, (rows, columns)), (len(cases), BUCKETS))
    rarity = np.log((1 + len(cases)) / (1 + np.bincount(columns, minlength=BUCKETS))) + 1
    weights, intercepts = np.zeros((BUCKETS, 2 * len(ENDS))), np.zeros(2 * len(ENDS))
    for place, ends in enumerate(ENDS):
        classes = np.array([_class_of(case, ends) for case in cases])
        fitted = LogisticRegression(C=PENALTY, max_iter=150, tol=1e-3).fit(features @ diags(rarity), classes)
        # Three classes: nothing said, one end, the other.
        weights[:, 2 * place : 2 * place + 2] = ((fitted.coef_[1:] - fitted.coef_[0]) * rarity).T
        intercepts[2 * place : 2 * place + 2] = fitted.intercept_[1:] - fitted.intercept_[0]
    scales = np.abs(weights).max(axis=0) / 127
    return SecondReader(
        language, np.round(weights / scales).astype(np.int8), scales.astype(np.float32), intercepts.astype(np.float32)
    )


def _class_of(case: Case, ends: Sequence[tuple[str, bool]]) -> int:
    wanted = [end in (case.wanted or ()) for end in ends]
    return 0 if wanted[0] == wanted[1] else 1 + wanted.index(True)


def _measure_left_out(files: Sequence[Path], sets: Sequence[list[Case]], language: Language) -> dict[str, Any]:
    """Set -> how many sentences the rules alone read right, and how many of these are asked back because of a second
    reader that has not seen the set."""
    accuracies = {}
    for file, cases in zip(files, sets, strict=True):
        others = [case for other in sets if other is not cases for case in other]
        second = fit_second_reader(others, language)
        alone, both = (_judge(cases, language, reader) for reader in (None, second))
        right = [after for before, after in zip(alone, both, strict=True) if before == "right"]
        accuracies[file.stem] = {
            "sentences": len(cases),
            "right_by_rules": len(right),
            "of_these_no_longer": len(right) - right.count("right"),
        }
    return accuracies


def _judge(cases: Sequence[Case], language: Language, second: SecondReader | None) -> list[str]:
    reader = WordsReader(language, lambda _: second)
    return [judge(case, reader.understand(case.sentence)) for case in cases]
