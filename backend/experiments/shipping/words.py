"""Makes the shipped words model of its training phrases, with its card."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from backend.learning.cards import source_commit
from backend.learning.shipped_files import DATASETS
from backend.learning.words.judging import judged, labelled_sentences
from backend.learning.words.model import DECAY, FEATURES, LETTERS, PASSES, made_words_models, to_bytes
from backend.learning.words.phrases import FOLDER, LANGUAGES, patterns, training_clauses
from backend.learning.words.understanding import WordsReader

NOTES = (
    "Training phrases are patterns filled by lot (`train_*.txt`: what is asked for; `others_*.txt`: what says nothing, "
    "or nothing clear), said in the ways of `ways_*.txt`.",
    "The test sentences were written and committed before any training phrase. But one author, a language model, wrote "
    "both within an hour and knew the test sentences when writing the phrases, as guesses at how visitors of a lab, "
    "elderly people and children talk: the two share that author's turns of phrase (some word for word, which the "
    "benchmark counts and leaves out once), and no participant has said any of them. Expect less with real people.",
    "The development sentences were written after the training phrases; phrases, rules and thresholds were changed by "
    "their errors, so their numbers say nothing. Nobody looked at errors on the test sentences before the model was "
    "kept; since then rules were only written shorter (one test sentence less is right).",
    "`slowly` alone counts as slower near the person, since no objective slows the robot down elsewhere. Left and "
    "right are asked back unless it is said whose.",
    "Sentences are read one by one: what was said before, irony and stories are not understood.",
)


def ship_words(seed: int = 0, folder: Path = DATASETS) -> dict[str, Any]:
    """Train both languages and store `words/model.words` with its card; seconds of one core."""
    models = made_words_models(seed)
    made = to_bytes(dict(models), {"seed": seed})
    out = folder / "words"
    out.mkdir(parents=True, exist_ok=True)
    (out / "model.words").write_bytes(made)
    known = {}
    for language in LANGUAGES:
        found = judged(labelled_sentences("development", language), WordsReader(models[language]).understand)
        wished = [one.foremost for one in found if one.foremost is not None]
        known[language] = {
            "patterns": len(patterns(language)),
            "clauses": len(training_clauses(language, seed)),
            "development_foremost": f"{sum(map(bool, wished))} of {len(wished)}",
        }
    card = {
        "kind": "words",
        "file": "model.words",
        "sha256": hashlib.sha256(made).hexdigest(),
        "command": f"python -m backend.experiments.ship words --seed {seed}",
        "seed": seed,
        "commit": source_commit(),
        "config": {"features": FEATURES, "letters": list(LETTERS), "decay": DECAY, "passes": PASSES},
        "languages": known,
        "parents": {
            path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(FOLDER.glob("*_??.t??"))
        },
        "notes": list(NOTES),
    }
    (out / "model.card.json").write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")
    return card
