"""Table 7.3: policies learned from each view's answers beside the base policy, in the same scenes, with intervals.

The learning and driving are jobs; who starts them and waits lives in `commands/report.py`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from backend.explain.printed import Section, Table

SCENES = 1_000  # spec 07
BASE = "base policy"
PERCENT = {"collision_rate": "collision (%)", "success_rate": "success (%)", "timeout_rate": "timeout (%)"}
MEANS = {
    "path_length_m": "path length (m)",
    "time_s": "time (s)",
    "accumulated_angle_rad": "accumulated angle (rad)",
    "path_area_m2": "area under the path (m²)",
    "min_human_distance_m": "minimum human distance (m)",
    "mean_speed_m_s": "mean speed (m/s)",
}


@dataclass(frozen=True)
class PolicyRow:
    """One policy. measured: of an evaluate job (`learning.evaluate.describe_table`). answers, accuracy: of the reward
    model on what it learned from; None for the base policy."""

    name: str
    policy: str
    measured: Mapping[str, Any]
    answers: int | None = None
    accuracy: float | None = None
    passed: bool | None = None

    def row(self) -> dict[str, object]:
        """For the CSV."""
        told: dict[str, object] = {
            "name": self.name,
            "policy": self.policy,
            "answers": self.answers,
            "training_accuracy": self.accuracy,
            "gate_passed": self.passed,
            "scenes": self.measured["n"],
        }
        for name in (*PERCENT, *MEANS):
            low, high = self.measured["intervals"][name]
            told |= {name: self.measured[name], f"{name}_low": low, f"{name}_high": high}
        return told


def policies_section(rows: Sequence[PolicyRow]) -> Section:
    """The table in the thesis's arrangement: a row per number, a column per policy."""
    heads = ["", *(row.name.replace("_", " ") for row in rows)]
    body = [[words, *(_cell(row, name, 100) for row in rows)] for name, words in PERCENT.items()]
    body += [[words, *(_cell(row, name, 1) for row in rows)] for name, words in MEANS.items()]
    body.append(["answers learned from", *("–" if row.answers is None else f"{row.answers:,}" for row in rows)])
    body.append(["of them predicted", *("–" if row.accuracy is None else f"{row.accuracy:.0%}" for row in rows)])
    failed = [row.name.replace("_", " ") for row in rows if row.passed is False]
    sentences = [
        f"One reward model per view, from all answers given in it, and a policy aligned with each; the same "
        f"{rows[0].measured['n']:,} fresh scenes for all. Brackets: 95 % intervals over scenes (Wilson for rates, "
        "bootstrap for means). They say how sure the numbers of these policies are, not how much policies learned from "
        "other people's answers would differ.",
    ]
    if failed:
        sentences.append(f"Not let through by the success gate, so that nobody is shown it: {', '.join(failed)}.")
    return Section("Policies learned from each view", sentences, [Table("Means over all scenes.", heads, body)])


def _cell(row: PolicyRow, name: str, factor: float) -> str:
    value, (low, high) = row.measured[name], row.measured["intervals"][name]
    if math.isnan(value):
        return "–"
    digits = 1 if factor == 100 else 2
    return f"{factor * value:.{digits}f} [{factor * low:.{digits}f}, {factor * high:.{digits}f}]"
