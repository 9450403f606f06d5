"""Meeting one's robot, in sentences and a table. Numbers are `meeting_findings.py`'s."""

from __future__ import annotations

import math

from desirepath.analysis.tested import Mean
from desirepath.explain.printed import Section, Table
from desirepath.report.findings import Findings
from desirepath.report.report_cells import NONE

TITLE = "Meeting their robot"


def meeting_section(found: Findings) -> Section:
    """Empty where nobody met one."""
    if found.met is None:
        return Section(TITLE)
    sentence = (
        f"After everything blind, {found.met.shown} people met the robot that learned from them, beside the usual one. "
        "They knew which was theirs, so nothing of this is in any test above or in what models learn from."
    )
    rows = [
        ["agreement: is that you? (1 not at all, 5 exactly)", *_cells(found.met.agreement, 2)],
        ["share who corrected a weight", *_cells(found.met.corrected, 2)],
        ["distance from learned to corrected weights (Euclidean; 0: kept)", *_cells(found.met.distance, 3)],
        ["the same, of those who corrected", *_cells(found.met.moved, 3)],
    ]
    about = "Of those who met an own robot: means with 95 % intervals."
    return Section(TITLE, [sentence], [Table(about, ["what", "mean", "95 %", "people"], rows)])


def _cells(mean: Mean, digits: int) -> list[str]:
    if not mean.n or not math.isfinite(mean.mean):
        return [NONE, NONE, str(mean.n)]
    known = math.isfinite(mean.low) and math.isfinite(mean.high)
    interval = f"{mean.low:.{digits}f} to {mean.high:.{digits}f}" if known else NONE
    return [f"{mean.mean:.{digits}f}", interval, str(mean.n)]
