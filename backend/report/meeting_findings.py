"""What people said when they met their robot, after everything blind: in no test and no blind data. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from backend.analysis.intervals import clustered_share, within
from backend.analysis.tested import Mean, mean_of
from backend.report.study_data import Meeting

AGREEMENT = (1.0, 5.0)
FARTHEST = 3.0  # of two vectors of nine weights from 0 to 1


@dataclass(frozen=True)
class Met:
    """shown: people who met an own robot; others: verdict -> people who were told why there is none. agreement: of
    those who met one, 1 to 5; corrected: share of them who changed a weight; distance: from learned to corrected
    weights, over those who met one, who changed nothing with 0; moved: over who changed something."""

    shown: int
    others: Mapping[str, int]
    agreement: Mean
    corrected: Mean
    distance: Mean
    moved: Mean


def met(meetings: Sequence[Meeting]) -> Met | None:
    """None where nobody was shown what was learned."""
    if not meetings:
        return None
    own = [one for one in meetings if one.verdict == "shown"]
    without = [one.verdict for one in meetings if one.verdict != "shown"]
    apart = [one.distance for one in own if one.distance is not None]
    moved = [one.distance for one in own if one.corrected and one.distance is not None]
    return Met(
        shown=len(own),
        others={verdict: without.count(verdict) for verdict in sorted(set(without))},
        agreement=within(mean_of([one.agreement for one in own]), *AGREEMENT),
        corrected=clustered_share([float(one.corrected) for one in own]),
        distance=within(mean_of(apart), 0.0, FARTHEST),
        moved=within(mean_of(moved), 0.0, FARTHEST),
    )
