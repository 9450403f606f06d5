"""Table 5.1 as printed, and the bars that are held against what is computed here."""

from __future__ import annotations

TABLE: dict[str, dict[str, float | None]] = {
    "ours": {"success": 100, "collision": 0, "human_m": 1.18, "frechet_m": 0.41, "time_s": 17.3},
    "no_person": {"success": 96.8, "collision": 2.7, "human_m": 0.52, "frechet_m": 0.57, "time_s": 16.9},
    "sac": {"success": 45.4, "collision": 53.2, "human_m": 1.06, "frechet_m": None, "time_s": None},
    "sac_0.98": {"success": 54.5, "collision": 44.4, "human_m": 0.91, "frechet_m": 1.06, "time_s": 20.8},
}
"""Success and collisions in % over 33 vectors x 100 rollouts; the others at full weight of the objective concerned."""

NAMES = {"ours": "ours", "no_person": "no human pose", "sac": "SAC-PR", "sac_0.98": "SAC-PR 0.98"}

SUCCESS_AT_LEAST, COLLISIONS_AT_MOST, SPEARMAN_AT_LEAST = 98.0, 1.0, 0.9
CORE_SECONDS_AT_MOST = 45 * 60.0
