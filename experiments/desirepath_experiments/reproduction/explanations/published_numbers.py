"""What the thesis prints in chapter 8, and what is put into the simulated rankers here."""

from __future__ import annotations

from desirepath.report.simulated_rankers import Effect

EFFECTS = {"outline": "XAI", "lidar": "Lidar", "outline x lidar": "XAI × Lidar"}
"""Effect as the analysis calls it -> as the tables print it; all with 1 and 23 degrees of freedom."""

TABLE_8_1 = {
    "outline": ("15.20", "< .001", "0.40"),
    "lidar": ("0.20", ".657", "0.01"),
    "outline x lidar": ("0.92", ".346", "0.04"),
}
"""Effect -> F, p, partial eta squared, of Kendall's tau."""
TABLE_8_2 = {
    "awareness": {
        "outline": ("5.39", ".030", "0.19"),
        "lidar": ("4.43", ".046", "0.16"),
        "outline x lidar": ("6.90", ".015", "0.23"),
    },
    "trust": {
        "outline": ("1.62", ".216", "0.07"),
        "lidar": ("1.72", ".202", "0.07"),
        "outline x lidar": ("0.80", ".380", "0.03"),
    },
    "plausibility": {
        "outline": ("3.86", ".062", "0.14"),
        "lidar": ("22.77", "< .001", "0.50"),
        "outline x lidar": ("3.26", ".084", "0.12"),
    },
}
SCALES = {"awareness": "Q1-6: SIPA", "trust": "Q7: trust", "plausibility": "Q8: plausibility"}
TAU = {True: (0.52, 0.11), False: (0.42, 0.12)}
"""With and without outlines: mean and standard deviation over people (8.4.1.1)."""
SIPA = {
    "neither": (4.6, 1.4),
    "outline": (5.5, 1.0),
    "lidar": (5.5, 1.0),
    "outline and lidar": (5.6, 1.0),
}

NOISE_PLACES = (0.6, 2.2)
"""Ours: how unsure a ranker is, in places; each one's own, drawn evenly in between."""
TRUST = (0.0, 0.6)
"""Ours: how far a ranker who has outlines goes by them rather than by what lies near and ahead; drawn evenly."""
RATED: dict[str, Effect] = {"awareness": (0.55, 0.55, -0.5), "plausibility": (0.0, 0.9, 0.0)}
"""Ours: what outlines, lidar and both beyond their sum add to opinions (standard deviations), near what was printed."""
