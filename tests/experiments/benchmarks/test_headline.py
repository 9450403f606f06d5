"""The headline is a median over preferences and seeds, of what can be attained; every seed draws scenes of its own."""

from __future__ import annotations

import json

import numpy as np
import pytest

from desirepath.installed import ROOT
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.shipped import load_policy
from desirepath.learning.policies.steerability import Course
from desirepath.learning.preferences.measures import MEASURES, typical_differences
from desirepath.learning.preferences.objectives import NAMES, best_possible, gains
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup, preference_setups
from desirepath_experiments.benchmarks.attainable import NOT_ARRIVED, PlannerConfig, plan_rollouts
from desirepath_experiments.benchmarks.headline import (
    MADE_OF_OBJECTIVES,
    HeadlineConfig,
    benchmark_headline,
    compare_with_attained,
    summarise,
    true_weights,
)
from desirepath_experiments.benchmarks.results import Progress

PREFERENCE_SETUPS = preference_setups()

FEW = PlannerConfig(rounds=5, copies=24)


def test_thirteen_preferences_are_made_of_objectives_and_weigh_one_together() -> None:
    assert len(MADE_OF_OBJECTIVES) == 13
    for name in MADE_OF_OBJECTIVES:
        assert true_weights(name).sum() == pytest.approx(1.0)
    with pytest.raises(LearningError, match="faces-person"):
        true_weights("faces-person")


@pytest.mark.parametrize("objective", ["shorter", "faster", "slower_near_person"])
def test_a_planned_drive_arrives_and_beats_the_base_policy_but_not_what_the_scene_allows(objective: str) -> None:
    scenes = scene_set("study_room", 12, purpose=Purpose.ALIGN_SELECT, seed=41)
    base = Course(scenes).rollout(load_policy("study_room/base"))
    weights = np.eye(len(NAMES))[NAMES.index(objective)]
    guides = [
        one.poses for one in rollout(get_setup("study_room"), load_policy("study_room/base").rollout_policy, scenes)
    ]
    best, drives = plan_rollouts(scenes, weights, FEW, guides)
    typical = typical_differences("study_room")
    arrived = best > NOT_ARRIVED
    assert arrived.mean() > 0.8
    assert gains(drives.measured / typical)[arrived] @ weights == pytest.approx(best[arrived])
    both = arrived & base.success
    assert best[both].mean() > (gains(base.measured / typical)[both] @ weights).mean()
    k = NAMES.index(objective)
    possible = best_possible(scenes)[:, k]
    measure = {"shorter": "path_length_m", "faster": "time_s", "slower_near_person": "speed_near_person_m_s"}[objective]
    assert (drives.measured[arrived, MEASURES.index(measure)] >= possible[arrived] - 0.2).all()


def test_a_plan_is_the_same_again() -> None:
    scenes = scene_set("open_field", 3, purpose=Purpose.ALIGN_SELECT, seed=42)
    weights = true_weights("min-human-distance")
    first, again = (plan_rollouts(scenes, weights, FEW)[0].tolist() for _ in range(2))
    assert first == again


def test_every_seed_answers_other_queries_and_reports_on_other_scenes() -> None:
    config = HeadlineConfig(
        preferences=("slow-near-person", "min-human-distance"),
        seeds=(3, 4),
        noises=(0.0,),
        answers=6,
        scenes=30,
        planned=8,
    )
    result = benchmark_headline(config, Progress(), FEW)
    assert result["simulated"]
    first, second = result["scenes"]
    assert first["last_scene_seed"] < second["first_scene_seed"]
    rows = {(row["preference"], row["seed"]): row for row in result["rows"]}
    assert len(rows) == 4
    assert rows["min-human-distance", 3]["base"] != rows["min-human-distance", 4]["base"]
    (summary,) = result["summary"]
    assert summary["runs"] == 4
    assert summary["worst_run"] <= summary["worst_share"] <= summary["median_share"]
    with pytest.raises(LearningError, match="faces-person"):
        benchmark_headline(HeadlineConfig(preferences=("faces-person",)), Progress())


def test_the_share_counts_only_where_all_arrive_and_what_a_policy_attained_was_attainable() -> None:
    scenes = scene_set("study_room", 10, purpose=Purpose.ALIGN_SELECT, seed=43)
    course = Course(scenes)
    base = course.rollout(load_policy("study_room/base"))
    own = course.rollout(load_policy("study_room/conditioned@farther=1"))
    true = true_weights("min-human-distance")
    nothing_planned_well = np.full(6, -50.0)
    said = compare_with_attained(own, own, base, nothing_planned_well, true, "study_room")
    assert 0 < said["share"] <= 1
    assert said["compared_in"] == int((base.success & own.success)[:6].sum())
    assert said["success"] == own.success.mean()


def test_the_median_is_over_runs_and_the_worst_is_a_preferences_median() -> None:
    shares = {"far": (0.9, 0.8, 0.7), "slow": (0.1, 0.3, 0.2)}
    numbers = ("share_true", "base", "own", "true_weights", "attained", "success", "success_base", "self_intersections")
    rows = [
        dict.fromkeys(numbers, 1.0)
        | {"preference": name, "lapse_rate": 0.0, "seed": k, "share": share, "foremost_found": True}
        for name, each in shares.items()
        for k, share in enumerate(each)
    ]
    (summary,) = summarise(rows)["summary"]
    assert summary["median_share"] == pytest.approx(0.5)
    assert (summary["worst_preference"], summary["worst_share"]) == ("slow", pytest.approx(0.2))
    assert summary["worst_run"] == pytest.approx(0.1)


def test_readme_and_numbers_lead_with_the_median_and_the_worst_of_the_stored_runs() -> None:
    told = ("README.md", "experiments/notebook/fifteen-answers.md")
    readme, headline = ((ROOT / name).read_text(encoding="utf-8") for name in told)
    first = next(line for line in readme.splitlines() if "15 answers" in line)
    for setup in PREFERENCE_SETUPS:
        stored = json.loads((ROOT / "experiments" / "results" / setup / "headline.json").read_text(encoding="utf-8"))
        assert stored["command"].startswith(f"desirepath benchmark headline --setup {setup}")
        always_right = stored["summary"][0]
        assert always_right == {**always_right, "lapse_rate": 0.0, "runs": len(stored["config"]["seeds"]) * 13}
        for share in ("median_share", "worst_share"):
            said = f"{100 * always_right[share]:.0f} %"
            assert said in first, (setup, share)
            assert said in headline, (setup, share)
        assert always_right["worst_preference"] in headline
