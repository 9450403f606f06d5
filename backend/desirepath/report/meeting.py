"""What people said when they met their robot, after everything blind, in numbers and words: in no test and no blind
data. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from desirepath.analysis.intervals import clustered_share, end_at_scale
from desirepath.analysis.tested import Mean, mean_of
from desirepath.explain.printed import Section
from desirepath.report.report_cells import means_section
from desirepath.report.study_data import FARTHEST, Meeting

AGREEMENT = (1.0, 5.0)


@dataclass(frozen=True)
class Met:
    """shown: people who met an own robot. agreement: 1 to 5; corrected: share of them who changed a weight; distance:
    from learned to corrected weights, of who changed nothing 0; moved: over who changed something."""

    shown: int
    agreement: Mean
    corrected: Mean
    distance: Mean
    moved: Mean


def summarise_meetings(meetings: Sequence[Meeting]) -> Met | None:
    """None where nobody was shown what was learned."""
    if not meetings:
        return None
    return Met(
        shown=len(meetings),
        agreement=end_at_scale(mean_of([meeting.agreement for meeting in meetings]), *AGREEMENT),
        corrected=clustered_share([float(meeting.corrected) for meeting in meetings]),
        distance=end_at_scale(mean_of([meeting.distance for meeting in meetings]), 0.0, FARTHEST),
        moved=end_at_scale(mean_of([meeting.distance for meeting in meetings if meeting.corrected]), 0.0, FARTHEST),
    )


def meeting_section(met: Met | None) -> Section:
    """Empty where nobody met one."""
    title = "Meeting their robot"
    if met is None:
        return Section(title)
    means = {
        "agreement: is that you? (1 not at all, 5 exactly)": (met.agreement, "{:.2f}"),
        "share who corrected a weight": (met.corrected, "{:.2f}"),
        "distance from learned to corrected weights (Euclidean; 0: kept)": (met.distance, "{:.3f}"),
        "the same, of those who corrected": (met.moved, "{:.3f}"),
    }
    return means_section(
        title,
        "Of those who met an own robot: means with 95 % intervals.",
        means,
        f"After everything blind, {met.shown} people met the robot that learned from them, beside the usual one. "
        "Who was shown none, or chose theirs less often than the protocol asks for, is not among them. "
        "They knew which was theirs, so nothing of this is in any test above or in what models learn from.",
    )
