"""The words model: a linear classifier of clauses on hashed words and letters, one per language.

The features are scikit-learn's `HashingVectorizer`, which learns nothing and so needs no pickle; what is learned is
the weights below. What its answers mean for a whole sentence is `understanding.py`'s.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from backend.learning.words.clauses import known_words, words_of
from backend.learning.words.phrases import FOLDER, LANGUAGES, Clause, Language, training_clauses

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

Floats = NDArray[np.float32]
FORMAT = "desirepath-words-1"
FILE = FOLDER / "model.words"  # a NumPy archive, but no policy or query set, which is what `.npz` in datasets are
FEATURES = (
    2**15
)  # ours: collisions of about 60,000 words and letters cost less than a point on the development sentences
LETTERS = (3, 5)
DECAY, PASSES = 1e-5, 12
NEGATORS = known_words(
    "not dont never no without avoid stop doesnt didnt shouldnt cant wont isnt neither nor hate dislike nobody mustnt "
    "nicht kein keine keinen keiner keinem nie niemals ohne bloss weniger schluss aufhoren hor less"
)


def features(forms: Sequence[str]) -> list[str]:
    """What a clause is judged by: words, pairs and threes of them, their letters; all once more where it negates."""
    words = ["^", *forms, "$"]
    found = list(forms)
    found += [f"{a} {b}" for a, b in pairwise(words)]
    found += [f"{a} {b} {c}" for a, b, c in zip(words, words[1:], words[2:], strict=False)]
    letters = []
    for word in forms:
        framed = f"<{word}>"
        letters += [
            "#" + framed[k : k + n] for n in range(LETTERS[0], LETTERS[1] + 1) for k in range(len(framed) - n + 1)
        ]
    negated = [f"!{one}" for one in (*forms, *letters)] if NEGATORS & set(forms) else []
    return found + letters + negated


@lru_cache(maxsize=1)
def _hashing() -> Any:
    from sklearn.feature_extraction.text import HashingVectorizer  # a second of imports, so not for who never asks

    return HashingVectorizer(analyzer=features, n_features=FEATURES, alternate_sign=False, norm="l2", dtype=np.float32)


def hashed(clauses: Sequence[Sequence[str]]) -> csr_matrix:
    """(n, FEATURES) float32, every row of length 1."""
    return _hashing().transform(clauses)


@dataclass(frozen=True)
class WordsModel:
    """labels: of clauses; weights (FEATURES, labels) and bias (labels,) float32."""

    language: Language
    labels: tuple[str, ...]
    weights: Floats
    bias: Floats

    def probabilities(self, clauses: Sequence[Sequence[str]]) -> Floats:
        """(n, labels) of clauses given as the forms of their words."""
        scores = np.asarray(hashed(clauses) @ self.weights, np.float32) + self.bias
        alone = 1.0 / (1.0 + np.exp(-scores))
        found: Floats = alone / alone.sum(axis=1, keepdims=True)
        return found


def fitted(clauses: Sequence[Clause], language: Language, decay: float = DECAY, seed: int = 0) -> WordsModel:
    """Logistic regression, one label against the others, by averaged gradient steps; decay: scikit-learn's alpha."""
    from sklearn.linear_model import SGDClassifier

    made = hashed([[word.form for word in words_of(clause.text)] for clause in clauses])
    logistic = SGDClassifier(
        loss="log_loss",
        alpha=decay,
        max_iter=PASSES,
        tol=None,
        average=True,
        random_state=seed,
        learning_rate="optimal",
    ).fit(made, [clause.label for clause in clauses])
    labels = tuple(str(label) for label in logistic.classes_)
    return WordsModel(language, labels, logistic.coef_.T.astype(np.float32), logistic.intercept_.astype(np.float32))


def made_words_models(seed: int = 0) -> dict[Language, WordsModel]:
    """Both languages' models of the training phrases; seconds of one core."""
    return {language: fitted(training_clauses(language, seed), language, seed=seed) for language in LANGUAGES}


def to_bytes(models: dict[Language, WordsModel], meta: dict[str, Any]) -> bytes:
    """A NumPy archive without pickled objects; weights in half precision, those that hardly count as 0."""
    arrays: dict[str, NDArray[Any]] = {}
    described = {"format": FORMAT, "features": FEATURES, "letters": list(LETTERS), **meta}
    described["labels"] = {language: model.labels for language, model in models.items()}
    for language, model in models.items():
        kept = np.where(np.abs(model.weights) < 0.01, 0, model.weights)
        arrays[f"weights_{language}"], arrays[f"bias_{language}"] = kept.astype(np.float16), model.bias
    arrays["meta"] = np.frombuffer(json.dumps(described).encode(), np.uint8)
    file = BytesIO()
    np.savez_compressed(file, allow_pickle=False, **arrays)
    return file.getvalue()


@lru_cache(maxsize=4)
def load_words_model(language: Language, path: Path | None = None) -> WordsModel:
    """The shipped model, or one of another file."""
    with np.load(path or FILE, allow_pickle=False) as file:
        meta = json.loads(bytes(file["meta"]))
        if meta["format"] != FORMAT or meta["features"] != FEATURES:
            raise ValueError(f"{path or FILE}: is no words model of format {FORMAT} with {FEATURES} features")
        weights = file[f"weights_{language}"].astype(np.float32)
        return WordsModel(language, tuple(meta["labels"][language]), weights, file[f"bias_{language}"])
