"""`desirepath reproduce adaptable`, with a tiny budget: whole tables and figures, and no task is computed twice."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from desirepath.learning.adaptable.objectives import thesis_vectors
from desirepath_experiments.reproduction.adaptable import computing
from desirepath_experiments.reproduction.adaptable.chapter import CHAPTER, along_edges, bars
from desirepath_experiments.reproduction.adaptable.plan import BUDGETS, NO_PERSON, OURS, SAC, AdaptableBudget, make_plan
from desirepath_experiments.reproduction.driver import reproduce, tasks_in
from desirepath_experiments.reproduction.published import published
from desirepath_experiments.reproduction.tasks import Task, Work
from desirepath_experiments.training.adaptable.training import AdaptableConfig

TABLE = published("adaptable")["table_5_1"]
TINY = AdaptableBudget("tiny", (0,), 20, 150, 45, 16, 2, 2, (SAC,), per_pair=1, alone=True)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("adaptable")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(computing, "RANKED_IN", 12)
        patch.setattr(computing, "HELD_OUT", 6)
        few = {"selection_scenes": 1, "solution_scenes": 1, "random_transitions": 2_000, "cloned_transitions": 960}
        patch.setattr(computing, "AdaptableConfig", partial(AdaptableConfig, **few))
        reproduce(CHAPTER, out, TINY, processes=1, command="desirepath reproduce adaptable")
    return out


def test_every_table_bar_and_figure_is_there(made: Path) -> None:
    results = json.loads((made / "results.json").read_text())
    assert set(results["table"]) == {OURS, SAC}
    assert {bar["name"] for bar in results["bars"]} >= {"success over 33 vectors, %", "Spearman along edges, least"}
    alone = results["single_objectives"]
    assert {name: of["measure"] for name, of in alone.items()} == {
        "demonstration": "frechet_m", "distance": "human_m", "efficiency": "time_s"
    }  # fmt: skip
    assert all(task["cpu_seconds"] <= 1.2 * task["seconds"] + 1 for task in results["tasks"].values())
    assert set(results["rewards"]) == {"programmed 0", "drawn 0"}
    html = (made / "report.html").read_text()
    assert "Table 5.1" in html
    assert f"({TABLE[OURS]['frechet_m']})" in html
    names = {path.name for path in (made / "figures").iterdir()}
    assert names >= {"edges_static.csv", "edges_walking.svg", "edges_intersection.png", "measures.csv"}
    drawn = (made / "figures" / "measures.csv").read_text().splitlines()
    assert len(drawn) == 1 + 4 * len(thesis_vectors())


def test_started_again_it_computes_only_what_is_missing(made: Path) -> None:
    judged = make_plan(TINY).judged[OURS, 0]
    Work(made / "work").path(judged.key).unlink()
    before = (made / "results.json").read_text()
    again = reproduce(CHAPTER, made, TINY, processes=1, command="desirepath reproduce adaptable")
    assert again["computed"] == 1
    assert json.loads(before)["table"] == json.loads((made / "results.json").read_text())["table"]


def test_the_whole_budget_has_three_seeds_and_every_baseline() -> None:
    plan = make_plan(BUDGETS["full"])
    assert [seed for variant, seed in plan.trained if variant == OURS] == [0, 1, 2]
    assert {variant for variant, _ in plan.trained} == set(TABLE)
    hidden = plan.trained[NO_PERSON, 0]
    assert hidden.params["config"]["without_person"]
    assert all(isinstance(task, Task) for task in tasks_in(plan))


def test_a_measure_that_follows_its_weight_correlates_with_it_whole() -> None:
    weights = thesis_vectors()
    arrays = {
        "static_outcome": np.ones((33, 4), dtype=np.int8),
        "static_human_m": np.repeat(0.5 + weights[:, [1]], 4, axis=1),
        "static_frechet_m": np.repeat(2 - weights[:, [0]], 4, axis=1),
        "static_time_s": np.repeat(20 - weights[:, [2]], 4, axis=1),
    }
    assert list(along_edges(arrays).values()) == pytest.approx([1] * 6)
    arrays["static_human_m"] = arrays["static_human_m"][:, ::-1] * 0 + 1
    assert along_edges(arrays)["distance against efficiency"] is None


def test_a_bar_is_met_by_the_worst_seed_or_not_at_all() -> None:
    row = {"success": 99.0, "collision": 0.5, "human_m": 1.3, "frechet_m": 0.4, "time_s": 17.0, "core_seconds": 60.0}
    good, bad = row | {"spearman": {"a": 0.95}}, row | {"spearman": {"a": 0.95}, "success": 97.0}
    found = {b["name"]: b["met"] for b in bars({OURS: {"seeds": {"0": good, "1": bad}}})}
    assert not found["success over 33 vectors, %"]
    assert found["collisions over 33 vectors, %"]
