"""What the thesis prints in chapter 7, and what is put into the simulated people here."""

from __future__ import annotations

from desirepath.learning.preferences.oracles import ResponseModel

VIEWS = ("immersive", "top_down", "first_person")
PRINTED = {"immersive": "VR", "top_down": "2D-TD", "first_person": "2D-FPV"}
PAIRS = (("immersive", "top_down"), ("immersive", "first_person"), ("top_down", "first_person"))

RANKINGS = {"usefulness": "R1 usefulness", "ease_of_use": "R2 ease of use", "intention": "R3 intention to use"}
"""Table 7.1: what people rank the three views by."""
FIRST = {"usefulness": {"immersive": 81.2}, "ease_of_use": {}, "intention": {"immersive": 90.6, "first_person": 0.0}}
"""Shares of first choices (%) that the text gives (7.4.3); it calls those of ease of use evenly distributed."""

AGREEMENT = {PAIRS[0]: (69.2, 9.6), PAIRS[1]: (68.6, 11.8), PAIRS[2]: (67.0, 14.2)}
"""Table 7.2: mean and standard deviation over people, %."""

ROLLOUTS: dict[str, tuple[float, float, float, float]] = {
    "collision_percent": (5.8, 5.8, 4.9, 5.2),
    "success_percent": (94.2, 94.1, 94.9, 94.8),
    "timeout_percent": (0.0, 0.1, 0.2, 0.0),
    "steps": (49.1, 49.5, 55.9, 50.0),
    "path_length_m": (4.9, 4.9, 5.4, 4.9),
    "time_s": (9.6, 9.7, 11.0, 9.8),
    "accumulated_angle_rad": (3.2, 3.1, 4.1, 2.8),
    "path_area_m2": (2.2, 1.8, 3.4, 2.1),
    "min_human_distance_m": (1.33, 1.20, 1.28, 1.25),
    "mean_speed_m_s": (0.51, 0.50, 0.49, 0.51),
}
"""Table 7.3: policies of VR, 2D-TD, 2D-FPV, then the one that is not aligned."""

RESPONSE_MODELS = {
    "immersive": ResponseModel(lapse_rate=0.05),
    "top_down": ResponseModel(lapse_rate=0.10, indifference=0.10),
    "first_person": ResponseModel(lapse_rate=0.15, indifference=0.25),
}
"""Ours: how answers stray in each view. The preference itself is the same in all three."""
FIRST_CHOICE = {
    "usefulness": {"immersive": 0.8, "first_person": 0.05},
    "intention": {"immersive": 0.9, "first_person": 0.01},
}
"""Ours: what is put into rankings, near what was printed."""
