"""Table 7.3: policies learned from each view's answers beside the base policy, in the same scenes, with intervals.

The learning and driving are jobs; who starts them and waits lives in `cli/report.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from desirepath.explain.printed import Section, Table
from desirepath.report.report_cells import NONE, name_in_words

SCENES = 1_000  # ch. 7
BASE = "base policy"
PERCENT = {"collision_rate": "collision (%)", "success_rate": "success (%)", "timeout_rate": "timeout (%)"}
MEANS = {
    "path_length_m": "path length (m)",
    "time_s": "time (s)",
    "accumulated_angle_rad": "accumulated angle (rad)",
    "path_area_m2": "area under the path (m²)",
    "min_human_distance_m": "minimum human distance (m)",
    "mean_speed_m_s": "mean speed (m/s)",
    "self_intersections": "self-intersections per rollout",
}


HELD_OUT = ("accuracy", "low", "high", "log_likelihood", "folds", "scenes")
MODELS = {
    "interface": "chapter 7's network",
    "linear": "linear model",
    "weights": "preference weights",
    "mlp": "chapter 6's network",
    "auto": "whichever predicts better",
}


@dataclass(frozen=True)
class PolicyRow:
    """One policy. measured: of an evaluate job (`learning.policies.evaluate.describe_table`). model, answers,
    accuracy, held_out (`learning.rewards.held_out.Predicted` as a dict): of the reward model that it was aligned with;
    None for the base policy."""

    name: str
    policy: str
    measured: Mapping[str, Any]
    model: str | None = None
    answers: int | None = None
    accuracy: float | None = None
    held_out: Mapping[str, Any] | None = None
    passed: bool | None = None

    def row(self) -> dict[str, object]:
        """For the CSV."""
        row: dict[str, object] = {
            "name": self.name,
            "policy": self.policy,
            "model": self.model,
            "answers": self.answers,
            "training_accuracy": self.accuracy,
            **{f"held_out_{name}": (self.held_out or {}).get(name) for name in HELD_OUT},
            "gate_passed": self.passed,
            "scenes": self.measured["n"],
        }
        for name in (*PERCENT, *MEANS):
            low, high = self.measured["intervals"][name]
            row |= {name: self.measured[name], f"{name}_low": low, f"{name}_high": high}
        return row


def policies_section(rows: Sequence[PolicyRow]) -> Section:
    """The table in the thesis's arrangement: a row per number, a column per policy."""
    heads = ["", *(_head(row) for row in rows)]
    cells: dict[str, Callable[[PolicyRow], str]] = {
        **{words: partial(_cell, name=name, factor=100) for name, words in PERCENT.items()},
        **{words: partial(_cell, name=name, factor=1) for name, words in MEANS.items()},
        "answers learned from": lambda row: NONE if row.answers is None else f"{row.answers:,}",
        "of them predicted": lambda row: NONE if row.accuracy is None else f"{row.accuracy:.0%}",
        "predicted in scenes not seen": _held_out_accuracy,
        "log-likelihood there, per answer": _log_likelihood,
    }
    body = [[words, *map(cell, rows)] for words, cell in cells.items()]
    failed = [_head(row) for row in rows if row.passed is False]
    sentences = [
        f"Reward models from all answers given in a view, and a policy aligned with each; the same "
        f"{rows[0].measured['n']:,} fresh scenes for all. Brackets: 95 % intervals over scenes (Wilson for rates, "
        "bootstrap for means). They say how sure the numbers of these policies are, not how much policies learned from "
        "other people's answers would differ.",
        *_better(rows),
    ]
    if failed:
        sentences.append(f"Not let through by the success gate, so that nobody is shown it: {', '.join(failed)}.")
    return Section("Policies learned from each view", sentences, [Table("Means over all scenes.", heads, body)])


def _head(row: PolicyRow) -> str:
    name = name_in_words(row.name)
    return name if row.model is None else f"{name}, {_model(row)}"


def _model(row: PolicyRow) -> str:
    return MODELS.get(str(row.model), str(row.model))


def _better(rows: Sequence[PolicyRow]) -> list[str]:
    """Which reward model predicts a view's answers better, where there are several: by held-out likelihood."""
    sentences = []
    for view in dict.fromkeys(row.name for row in rows):
        judged = [row for row in rows if row.name == view and row.held_out is not None]
        if len(judged) > 1:
            best = max(judged, key=_likelihood)
            others = [f"{_log_likelihood(row)} of {_model(row)}" for row in judged if row != best]
            sentences.append(
                f"{name_in_words(view).capitalize()}: {_model(best)} predicts answers about scenes it did not see "
                f"better ({_log_likelihood(best)} per answer against {', '.join(others)}; a coin has -0.69), so its "
                "policy is the one to take."
            )
    return sentences


def _likelihood(row: PolicyRow) -> float:
    return float((row.held_out or {})["log_likelihood"])


def _log_likelihood(row: PolicyRow) -> str:
    return NONE if row.held_out is None else f"{_likelihood(row):.2f}"


def _held_out_accuracy(row: PolicyRow) -> str:
    if row.held_out is None:
        return NONE
    share, low, high = (100 * row.held_out[name] for name in ("accuracy", "low", "high"))
    return f"{share:.0f} % [{low:.0f}, {high:.0f}]"


def _cell(row: PolicyRow, name: str, factor: float) -> str:
    value, (low, high) = row.measured[name], row.measured["intervals"][name]
    if math.isnan(value):
        return NONE
    digits = 1 if factor == 100 else 2
    return f"{factor * value:.{digits}f} [{factor * low:.{digits}f}, {factor * high:.{digits}f}]"
