"""What the thesis published, kept as data with its source. What we find lives in the tasks."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AlignmentRow:
    """A row of table 6.2. Rates in [0, 1]; stars: the published mark of the t-test against EnQ-15."""

    min_human_distance_m: float
    success_rate: float
    collision_rate: float
    timeout_rate: float
    stars: str


TABLE_6_2_SOURCE = "table 6.2: 10 alignments x 100 rollouts, RAW 100 rollouts"
TABLE_6_2 = {
    "EnQ-15": AlignmentRow(3.2, 0.898, 0.034, 0.068, ""),
    "EnQ-60": AlignmentRow(2.1, 0.924, 0.039, 0.037, "**"),
    "BL-15": AlignmentRow(2.5, 0.939, 0.037, 0.024, "***"),
    "BL-60": AlignmentRow(2.7, 0.868, 0.036, 0.096, "***"),
    "RAW": AlignmentRow(1.2, 0.94, 0.06, 0.0, "***"),
}

KAPPA = 0.0625  # table 6.1; section 6.5.1.1 for the rest
ENSEMBLE_STEPS = 25_000
ENSEMBLE_SUCCESS = 0.91
ENSEMBLE_DIVERSITY = 0.7
KAPPA_WHERE_SUCCESS_FALLS = 0.07
QUERIES_WHERE_BASELINE_OVERTAKES = 18  # section 6.5.2 and figure 6.4
