"""The analysis plan that a protocol declares, its hash, and how what was done deviates from it. Knows no data."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from desirepath.analysis.tested import Correction
from desirepath.grammar.error_words import parse
from desirepath.grammar.source import Source, file_text

Metric = Literal["path_length", "time", "mean_speed", "accumulated_angle", "min_human_distance", "path_area"]
METRICS: dict[Metric, tuple[str, str]] = {
    "path_length": ("length", "m"),
    "time": ("time", "s"),
    "mean_speed": ("mean speed", "m/s"),
    "accumulated_angle": ("accumulated angle", "rad"),
    "min_human_distance": ("minimum human distance", "m"),
    "path_area": ("area under the path", "m²"),
}
"""Fields of `analysis.metrics.TrajectoryMetrics` that ch. 7 compares: words and unit."""


class Equivalence(BaseModel):
    """What counts as no difference, declared before the data. rating: in points of the scale; share: of choices for the
    own policy, about one half."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rating: float | None = Field(None, gt=0)
    share: float | None = Field(None, gt=0, lt=0.5)


class AnalysisPlan(BaseModel):
    """What is tested and how, declared before the data (`analysis:` in a protocol). Defaults: ch. 7 unless marked.

    items: the questionnaire that is answered after each block, each item, or the score of a validated scale, by itself;
    default every one that is answered under two or more conditions. pairs: of which items the pairs are tested, of
    those where the test over all conditions is significant or always, as chapter 2 did. pairs_over: corrected over the
    pairs of all items together, or over one item's pairs, as the thesis did (in 12 % of studies with ten items it then
    finds a pair that does not differ). ranking: the questionnaire with forced rankings (first choices, then in pairs);
    default every ranking item. own: how the own policy is tested against others. correction: over the items, over the
    rankings, over the arms. sessions: whose answers count. min_probes: fewer repeated queries of a person within a
    condition than these say nothing about consistency.

    equivalence: margins within which a difference counts as none (two one-sided tests). bayes_factors: beside the tests
    of two. models: cumulative-link mixed models of the items and mixed logistic models of the choices beside the tests.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    alpha: float = Field(0.05, gt=0, lt=0.5)
    items: str | None = None
    pairs: Literal["where_significant", "always"] = "where_significant"
    pairs_over: Literal["items", "item"] = "items"  # ours
    ranking: str | None = None
    own: Literal["sign", "signed_ranks"] = "sign"
    correction: Correction = "holm"  # ours; the thesis names none over the items
    sessions: Literal["completed", "all"] = "completed"  # ours
    metrics: tuple[Metric, ...] = tuple(METRICS)
    min_probes: int = Field(5, ge=1)
    equivalence: Equivalence | None = None
    bayes_factors: bool = False
    models: bool = False

    def digest(self) -> str:
        """sha256 of the plan as canonical JSON, defaults filled in."""
        return hashlib.sha256(json.dumps(self.model_dump(mode="json"), sort_keys=True).encode()).hexdigest()


def find_declared_plan(protocol: dict[str, Any]) -> AnalysisPlan | None:
    """The plan of a study's frozen protocol, None where it declares none."""
    declared = protocol.get("analysis")
    return AnalysisPlan.model_validate(declared) if declared is not None else None


def deviations(declared: AnalysisPlan | None, used: AnalysisPlan) -> list[str]:
    """How the plan that was used differs from the declared one, a sentence each."""
    if declared is None:
        return ["No analysis plan was declared in the protocol; everything here is exploratory."]
    before, now = declared.model_dump(mode="json"), used.model_dump(mode="json")
    return [
        f"{name}: declared {_in_words(before[name])}, used {_in_words(now[name])}."
        for name in before
        if before[name] != now[name]
    ]


def _in_words(value: object) -> str:
    if value is None:
        return "the default"
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def read_plan(file: Path) -> AnalysisPlan:
    """A plan written by itself as YAML. Raises ProtocolError naming the field, what it holds and what would work."""
    return parse(Source(file.name, file_text(file)), AnalysisPlan)
