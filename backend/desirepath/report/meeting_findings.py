"""What people said when they met their robot, after everything blind: in no test and no blind data. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from desirepath.analysis.intervals import clustered_share, within
from desirepath.analysis.tested import Mean, mean_of
from desirepath.report.study_data import Meeting

AGREEMENT = (1.0, 5.0)
FARTHEST = 3.0  # of two vectors of nine weights from 0 to 1


@dataclass(frozen=True)
class Met:
    """shown: people who met an own robot. agreement: 1 to 5; corrected: share of them who changed a weight; distance:
    from learned to corrected weights, of who changed nothing 0; moved: over who changed something."""

    shown: int
    agreement: Mean
    corrected: Mean
    distance: Mean
    moved: Mean


def met(meetings: Sequence[Meeting]) -> Met | None:
    """None where nobody was shown what was learned."""
    if not meetings:
        return None
    return Met(
        shown=len(meetings),
        agreement=within(mean_of([one.agreement for one in meetings]), *AGREEMENT),
        corrected=clustered_share([float(one.corrected) for one in meetings]),
        distance=within(mean_of([one.distance for one in meetings]), 0.0, FARTHEST),
        moved=within(mean_of([one.distance for one in meetings if one.corrected]), 0.0, FARTHEST),
    )
