"""`desirepath benchmark rules`: are rules in plain words read as they were meant, and does a robot obey them?

Sentences: `datasets/words/rules_test_LANGUAGE.tsv` (columns manner, context, change, sentence), by somebody who had
not seen the grammar, and not looked at since. context: labels of `Condition`, several that must hold together with
`+`, `not:` before one that must not; `always`; `unknown`: must be asked back. change: labels of `Wish` and `Zone`,
several with `;`; `ask`: must be asked back. --sentences measures others. Obedience: TOLD, each in fresh homes, against
the same policy without rules in the same homes.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import pydantic
from pydantic import Field

from desirepath.analysis.estimates import wilson
from desirepath.learning.rules.homes import rule_scene
from desirepath.learning.rules.obedience import drive_by, measure_obedience
from desirepath.learning.rules.reading import RuleRead, read_rule
from desirepath.learning.rules.rule import OPPOSITE
from desirepath.learning.scene_sets import Purpose, first_seed
from desirepath.learning.words.lexicon import FOLDER, LANGUAGES, Language
from desirepath_experiments.benchmarks.results import Progress

TOLD = (
    "When I sit, keep behind me",
    "When I walk, keep your distance",
    "When I stand, come closer",
    "In the kitchen go slower",
    "Slow down near me",
    "Never between me and the sofa",
    "Keep away from the table",
    "When I sit, keep me on your left",
    "Near the bed drive smoothly",
    "When I walk, keep away from the furniture",
)
CONTRARY = {"alone": "others", "no_hurry": "hurry"}
KINDS = ("right", "asked", "missed", "wrong_direction", "wrong_otherwise")


@dataclass(frozen=True)
class LabelledRule:
    """context: labels of what must hold, `unknown` of what no robot here can tell; change: labels, `ask` of what must
    be asked back."""

    manner: str
    context: frozenset[str]
    change: frozenset[str]
    sentence: str


def read_labelled(language: Language, folder: Path = FOLDER) -> list[LabelledRule]:
    """Nothing where nobody has written them."""
    file = folder / f"rules_test_{language}.tsv"
    if not file.is_file():
        return []
    with file.open(encoding="utf-8", newline="") as opened:
        rows = list(csv.DictReader(opened, delimiter="\t", quoting=csv.QUOTE_NONE))
    return [
        LabelledRule(
            row["manner"],
            frozenset(_context(label) for label in row["context"].split("+")),
            frozenset(row["change"].split(";")),
            row["sentence"],
        )
        for row in rows
    ]


def _context(label: str) -> str:
    """The same by one name: who is not alone is with others."""
    bare = label.removeprefix("not:")
    if label == bare or bare == "unknown":
        return bare
    turned = {"others": "alone", "hurry": "no_hurry"} | CONTRARY
    return turned.get(bare, label)


def judge_context(labelled: LabelledRule, got: RuleRead) -> str:
    """`right`: all conditions and no other, or asked back where nobody could know it; `asked`; `wrong`."""
    asked = any(one.about == "context" for one in got.asked)
    if "unknown" in labelled.context:
        return "right" if asked else "wrong"
    context, change = _as_meant(labelled.context, labelled.change)
    if _as_meant(got.rule.context, got.rule.changes)[0] == context and not asked:
        return "right"
    return "asked" if asked or (not got.rule.complete and got.asked and "ask" not in change) else "wrong"


def judge_change(labelled: LabelledRule, got: RuleRead) -> str:
    """One of KINDS."""
    asked = any(one.about in ("wish", "nothing") for one in got.asked)
    changes = _as_meant(got.rule.context, got.rule.changes)[1]
    if labelled.change == {"ask"}:
        return "right" if asked or not changes else "wrong_otherwise"
    wanted = _as_meant(labelled.context, labelled.change)[1]
    if changes & frozenset(_turned(label) for label in wanted):
        return "wrong_direction"
    if changes == wanted:
        return "asked" if asked else "right"
    if changes <= wanted:
        return "asked" if asked or changes else "missed"
    return "wrong_otherwise"


def _as_meant(context: frozenset[str], change: frozenset[str]) -> tuple[frozenset[str], frozenset[str]]:
    """Slower near the person, or not, said either way; less of one of two opposites as more of the other."""
    change = frozenset(_LESS.get(label, label) for label in change)
    if "near:person" in context and "slower_near_person:-" in change:
        context = context - {"near:person"} or frozenset({"always"})
    if "near:person" in context and change & {"faster:-", "slower_near_person:+"}:
        context = context - {"near:person"} or frozenset({"always"})
        change = change - {"faster:-"} | {"slower_near_person:+"}
    return context, change


_LESS = {f"{name}:-": f"{other}:+" for name, other in OPPOSITE.items()}


def _turned(label: str) -> str:
    pairs = {"farther": "closer", "person_on_left": "person_on_right"}
    pairs |= {other: one for one, other in pairs.items()}
    zones = {"zone:front": "zone:behind", "zone:behind": "zone:front"}
    name, _, sign = label.rpartition(":")
    if label in zones:
        return zones[label]
    if name in pairs:
        return f"{pairs[name]}:{sign}"
    return f"{name}:{'-' if sign == '+' else '+'}" if sign in ("+", "-") else f"not {label}"


@pydantic.dataclasses.dataclass(frozen=True)
class RulesConfig:
    """Which sentences are read, and in how many fresh homes a robot is watched."""

    scenes: Annotated[int, Field(ge=20, le=2_000, description="Homes.")] = 300
    seed: Annotated[int, Field(ge=0, le=1_000, description="Of the homes.")] = 0
    sentences: Annotated[
        Path | None,
        Field(description="A folder of rules_test_en.tsv and rules_test_de.tsv; then no robot drives."),
    ] = None


def benchmark_rules(config: RulesConfig, progress: Progress | None = None) -> dict[str, Any]:
    """Shares with 95 % intervals: Wilson's of sentences, resampled homes of obedience."""
    progress = progress or Progress()
    folder = config.sentences or FOLDER
    read = {language: _summarise(read_labelled(language, folder), language) for language in LANGUAGES}
    if config.sentences is not None:
        return {"sentences": read}
    first = first_seed(Purpose.REPORT, config.seed)
    scenes = [rule_scene(first + number) for number in range(config.scenes)]
    usual = drive_by([], scenes)
    obeyed: dict[str, Any] = {}
    for sentence in TOLD:
        found = measure_obedience(read_rule(sentence, "en").rule, scenes, usual)
        obeyed[sentence] = asdict(found)
        progress.tell(f"{sentence}: {found.obeyed.value:.2f}, without {found.without.value:.2f}")
    return {"sentences": read, "obeyed": obeyed}


def _summarise(labelled: Sequence[LabelledRule], language: Language) -> dict[str, Any]:
    got = [(one, read_rule(one.sentence, language)) for one in labelled]
    contexts = [judge_context(one, read) for one, read in got]
    changes = [judge_change(one, read) for one, read in got]
    return {
        "n": len(got),
        "context": {name: _share(contexts.count(name), len(got)) for name in ("right", "asked", "wrong")},
        "change": {name: _share(changes.count(name), len(got)) for name in KINDS},
    }


def _share(hits: int, n: int) -> dict[str, float]:
    return asdict(wilson(hits, n)) if n else {}
