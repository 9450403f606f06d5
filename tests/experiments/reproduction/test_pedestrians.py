"""`desirepath reproduce pedestrians` with next to nothing to compute: table, bars, report, going on after a stop."""

import json

import pytest

from desirepath.learning.cards import SOCIAL
from desirepath.learning.pedestrians.crowd_networks import VARIANTS
from desirepath.simulation.pedestrians import CrowdConditions
from desirepath_experiments.reproduction.driver import reproduce
from desirepath_experiments.reproduction.pedestrians import plan
from desirepath_experiments.reproduction.pedestrians.chapter import CHAPTER
from desirepath_experiments.reproduction.pedestrians.plan import (
    BUDGETS,
    BY_REWARD,
    PLANNED,
    ByReward,
    PedestrianBudget,
    make_plan,
)
from desirepath_experiments.reproduction.tasks import from_bytes

LEAST = PedestrianBudget(
    "small",
    (0,),
    ("ours", "b3", "ours_td3"),
    128,
    2,
    1,
    (0.6,),
    (1,),
    ByReward(16, 8, 8, random_transitions=64),
    selection_scenes=2,
)

ELSEWHERE = ("speed_0.6", "number_1", "orca", "social_force")


def test_a_tasks_name_knows_what_is_judged_and_what_networks_are_given(monkeypatch):
    def names():
        return {
            key: (task.key, task.needs[0].key if task.needs else "") for key, task in make_plan(LEAST).judged.items()
        }

    before = names()
    for name, value in (("HELD_UP_S", 3.0), ("HELD_UP_SHARE", 0.2), ("UNSEEN_HOMES", CrowdConditions(area_m2=9.0))):
        with monkeypatch.context() as how_pedestrians_walk:
            how_pedestrians_walk.setattr(plan, name, value)
            after = names()
        assert all(before[key][0] != after[key][0] for key in before), name
        assert all(before[key][1] == after[key][1] for key in before), f"{name}: trainings are as they were"
    for name, value in (("GAP_TIMES", 1.0), ("FIRST_NUMBERS", {"drawn": "otherwise"})):
        with monkeypatch.context() as networks:
            networks.setattr(plan, name, value)
            after = names()
        assert all((before[key] != after[key]) == (key[1] >= 0) for key in before), name
    monkeypatch.setattr(plan, "SEARCH_BY_VELOCITY", {**plan.SEARCH_BY_VELOCITY, "stands_m_s": 0.1})
    after = names()
    asked = {key for key in before if before[key] != after[key]}
    assert asked == {("ours", 0), ("b3", 0), ("constant_velocity", -1)}, "who imitates the search, and the search"


def test_the_small_budget_trains_all_by_imitation_with_three_seeds():
    small = make_plan(BUDGETS["small"])
    assert set(small.judged) == {(variant, seed) for variant in VARIANTS for seed in (0, 1, 2)} | {
        (planner, -1) for planner in PLANNED
    }


def test_the_full_budget_trains_everything_alike_with_three_seeds():
    full = make_plan(BUDGETS["full"])
    assert {variant for variant, seed in full.judged if seed >= 0} == {*VARIANTS, *BY_REWARD}
    assert len({seed for _, seed in full.judged if seed >= 0}) == 3
    configs = [task.needs[0].params["config"] for (_, seed), task in full.judged.items() if seed == 0]
    assert {config.get("learner") for config in configs} == {None, "td3", "ddpg"}
    assert len({(c["updates"], c["batch_size"]) for c in configs if "learner" in c}) == 1
    by_imitation = [{k: v for k, v in c.items() if k != "variant"} for c in configs if "learner" not in c]
    assert all(one == by_imitation[0] for one in by_imitation)
    assert by_imitation[0]["labels"] == BUDGETS["full"].labels


def test_a_run_writes_its_table_and_begins_nothing_twice(tmp_path):
    told = []
    first = reproduce(CHAPTER, tmp_path, LEAST, processes=1, command="made in a test", tell=told.append)
    assert first["computed"] == len(PLANNED) + 2 * 2 + (1 + 2)
    results = json.loads((tmp_path / "results.json").read_text())
    assert set(results["rates"]["ours"]) >= {"published", "no_icp", "no_walls", "homes", "speed 0.6", "number 1"}
    outcomes = [
        {name: len(array) for name, array in from_bytes(path.read_bytes()).arrays.items()}
        for path in (tmp_path / "work").glob("judged-*.npz")
    ]
    assert outcomes == 3 * [dict.fromkeys(("published", "homes"), 2) | dict.fromkeys(ELSEWHERE, 1)]
    assert results["bars"][0]["value"] == results["rates"]["ours"]["published"]["success"]["mean"]
    assert [bar["met"] for bar in results["bars"]] == [bar["value"] >= bar["at_least"] for bar in results["bars"]]
    social = results["social"]["constant_velocity"]
    assert set(social) == {"published", "homes"}
    assert set(social["published"]) == {"min_human_distance_m", *SOCIAL}
    (stored,) = [task for task in results["tasks"] if task == make_plan(LEAST).judged["ours", 0].key]
    judged = from_bytes((tmp_path / "work" / f"{stored}.npz").read_bytes())
    assert results["social"]["ours"]["homes"]["spl"]["mean"] == pytest.approx(judged.meta["social"]["homes"]["spl"])
    b3 = results["rates"]["ours"]["published"]["success"]["mean"] - results["leads"]["published"]["b3"]["mean"]
    assert b3 == pytest.approx(results["rates"]["b3"]["published"]["success"]["mean"])
    report = (tmp_path / "report.html").read_text()
    assert report.index("least distance, m") < report.index("irregularity, rad/m")
    assert "16 updates of 8" in report
    assert reproduce(CHAPTER, tmp_path, LEAST, processes=1)["computed"] == 0
