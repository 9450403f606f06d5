"""Chapter 6 end to end with a tiny budget, resumed, and its figures against their CSVs."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from desirepath.learning.alignment.fine_tuning import FineTuningConfig
from desirepath.learning.alignment.gate import GateRule
from desirepath.learning.alignment.relabelling import RelabellingConfig
from desirepath.learning.alignment.thesis import thesis_config
from desirepath.learning.cards import read_config
from desirepath.learning.td3.base import BaseConfig
from desirepath.learning.td3.ensemble import PolicyEnsembleConfig
from desirepath.simulation.trajectory import Outcome
from desirepath_experiments.reproduction.driver import reproduce, tasks_in
from desirepath_experiments.reproduction.enquery.chapter import (
    CHAPTER,
    EnqueryResults,
    crossing,
    nearest_cell,
    results_of,
    table_of_recipe,
)
from desirepath_experiments.reproduction.enquery.figures import draw_accuracy, draw_distances, draw_sweep
from desirepath_experiments.reproduction.enquery.plan import (
    BUDGETS,
    PRINTED,
    EnqueryBudget,
    make_plan,
    read_alignment,
    stored_alignment,
)
from desirepath_experiments.reproduction.published import published
from desirepath_experiments.reproduction.tasks import TaskResult, Work

TINY = replace(
    BUDGETS["small"],
    name="tiny",
    kappas=(0.0, PRINTED["kappa"]),
    marks=(25, 50),
    sweep_scenes=6,
    answers=(1, 4),
    repetitions=2,
    test_pairs=8,
    alignments=1,
    rollouts=8,
    thesis_updates=10,
    thesis_epochs=2,
    fine_tuning_updates=20,
    fine_tuning_checkpoints=2,
    states=50,
    base_transitions=600,
    selection_scenes=6,
    gate_scenes=6,
    replay_transitions=1_000,
    recipes=("thesis", "fine_tuning", "instant"),
    starts=2,
    flow_fields=(),
)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("reproduction")


@pytest.fixture(scope="module")
def summary(out: Path) -> dict[str, Any]:
    return reproduce(CHAPTER, out, TINY, processes=1, command="desirepath reproduce enquery")


@pytest.fixture(scope="module")
def results(out: Path, summary: dict[str, Any]) -> EnqueryResults:
    return results_of(make_plan(TINY, 0), Work(out / "work").load)


def test_one_command_leaves_a_report_with_figures_and_their_data(out: Path, summary: dict[str, Any]) -> None:
    report = (out / "report.html").read_text()
    assert "EnQ-15" in report
    assert "action diversity. Ours is" in report  # what is not explained is said
    assert "http" not in report.replace("http://www.w3.org", "")  # it needs nothing from elsewhere
    assert report.count("data:image/svg+xml;base64,") == len(summary["figures"]) / 3
    assert {Path(path).suffix for path in summary["figures"]} == {".png", ".svg", ".csv"}
    assert all(Path(path).stat().st_size > 100 for path in summary["figures"])
    stored = json.loads((out / "results.json").read_text())
    assert stored["simulated"] is True
    assert stored["results"]["tables"]["thesis"][0]["published"] == published("enquery")["table_6_2"]["EnQ-15"]


def test_a_second_run_computes_only_what_is_missing(out: Path, summary: dict[str, Any]) -> None:
    work = out / "work"
    before = {path.name: path.stat().st_mtime_ns for path in work.glob("*.npz")}
    lost = next(work.glob("raw-*.npz"))
    lost.unlink()
    (work / "sweep-half.1.partial").write_bytes(b"what a killed process left")
    again = reproduce(CHAPTER, out, TINY, processes=1, command="desirepath reproduce enquery")
    after = {path.name: path.stat().st_mtime_ns for path in work.glob("*")}
    assert again["computed"] == 1
    assert [name for name, when in before.items() if after[name] != when] == [lost.name]
    assert "sweep-half.1.partial" not in after
    assert again["tables"] == summary["tables"]


def rows_of(out: Path, name: str) -> list[dict[str, str]]:
    with (out / "figures" / f"{name}.csv").open() as file:
        return list(csv.DictReader(file))


def test_the_heat_maps_show_what_their_csv_says(out: Path, results: EnqueryResults) -> None:
    rows = rows_of(out, "sweep")
    assert {float(row["kappa"]) for row in rows} == {0.0, PRINTED["kappa"]}
    panels = [ax for ax in draw_sweep(results.sweep).figure.axes if ax.images]
    for panel, column in zip(panels, ("action_diversity", "success_rate"), strict=True):
        ordered = sorted(rows, key=lambda row: (int(row["steps"]), float(row["kappa"])))
        told = np.array([float(row[column]) for row in ordered]).reshape(len(TINY.marks), len(TINY.kappas))
        np.testing.assert_allclose(panel.images[0].get_array(), told)


def test_the_curves_show_what_their_csv_says(out: Path, results: EnqueryResults) -> None:
    rows = [row for row in rows_of(out, "accuracy") if row["test_set"] == "segments"]
    panel = draw_accuracy(results).figure.axes[1]
    lines = {line.get_label(): line for line in panel.get_lines()}
    for source in ("EnQ", "BL"):
        told = [row for row in rows if (row["answers_about"], row["model"]) == (source, "mlp")]
        np.testing.assert_allclose(lines[f"{source}, neural"].get_xdata(), [int(row["answers"]) for row in told])
        np.testing.assert_allclose(lines[f"{source}, neural"].get_ydata(), [float(row["accuracy"]) for row in told])


def test_the_dots_show_what_their_csv_says(out: Path, results: EnqueryResults) -> None:
    rows = [row for row in rows_of(out, "distances") if row["recipe"] == "thesis"]
    panel = draw_distances(results).figure.axes[0]
    drawn = [float(y) for dots in panel.collections[0::2] for _, y in dots.get_offsets()]
    np.testing.assert_allclose(drawn, [float(row["min_human_distance_m"]) for row in rows])


def test_rows_share_their_scenes_and_say_how_far_they_came(results: EnqueryResults) -> None:
    for rows in results.tables.values():
        assert [row.name for row in rows] == ["EnQ-15", "EnQ-60", "BL-15", "BL-60", "RAW"]
        raw = rows[-1]
        assert raw.share_of_the_way == 0
        for row in rows:
            way = results.ceiling_m - raw.min_human_distance_m
            assert row.share_of_the_way == pytest.approx((row.min_human_distance_m - raw.min_human_distance_m) / way)
            assert row.success_rate + row.collision_rate + row.timeout_rate == pytest.approx(1)


def driven(distances: list[float], outcomes: list[Outcome]) -> TaskResult:
    n = len(distances)
    ones = np.ones(n)
    arrays = {"min_human_distance": np.array(distances), "outcome": np.array(outcomes), "ceiling": 3 * ones}
    return TaskResult(
        {"gate_passed": True}, arrays | dict.fromkeys(("time", "path_length", "self_intersections"), ones)
    )


def test_a_table_by_hand() -> None:
    """Alignments of mean 2.0, 2.2, 2.4 m against 1.0, 1.2, 1.4: t = 1 / (0.2 sqrt(2 / 3)) = 6.124, df = 4."""
    good, bad = Outcome.SUCCESS, Outcome.COLLISION
    near = [driven([mean - 0.5, mean + 0.5], [good, good]) for mean in (1.0, 1.2, 1.4)]
    far = [driven([mean - 0.5, mean + 0.5], [good, bad]) for mean in (2.0, 2.2, 2.4)]
    raw = driven([0.5, 1.5], [good, good])
    rows = table_of_recipe("thesis", {"EnQ-15": far, "EnQ-60": near, "BL-15": near, "BL-60": far}, raw)
    first, second, _, last, base = rows
    assert [row.name for row in rows] == ["EnQ-15", "EnQ-60", "BL-15", "BL-60", "RAW"]
    assert (first.min_human_distance_m, first.success_rate, first.collision_rate) == pytest.approx((2.2, 0.5, 0.5))
    assert (first.share_of_the_way, first.paired_gain_m) == pytest.approx((1.2 / 2, 1.2))
    assert first.per_alignment_test is None
    assert second.per_alignment_test is not None
    assert second.per_alignment_test.statistic == pytest.approx(6.124, abs=5e-4)
    assert second.per_alignment_test.df == 4
    assert second.per_alignment_test.p_corrected == pytest.approx(4 * second.per_alignment_test.p)
    assert last.per_alignment_test is not None
    assert last.per_alignment_test.p_corrected == 1
    assert base.per_alignment_test is not None
    assert base.per_alignment_test.statistic == pytest.approx(1.2 / (0.2 / 3**0.5))  # one policy: a fixed value
    assert second.per_episode_test is not None
    assert second.per_episode_test.df == 10


def test_alignments_that_all_came_out_alike_are_not_tested() -> None:
    """A policy that is told the same every time differs by rounding only: no spread, and no p of 0."""
    good = [Outcome.SUCCESS, Outcome.SUCCESS]
    alike = [driven([2.0, 3.0], good)] * 3
    rounded = [driven([2.0, 3.0 + 1e-7], good)] * 3
    spread = [driven([mean - 0.5, mean + 0.5], good) for mean in (1.0, 1.2, 1.4)]
    rows = table_of_recipe(
        "instant", {"EnQ-15": alike, "EnQ-60": rounded, "BL-15": alike, "BL-60": spread}, driven([0.5, 1.5], good)
    )
    tests = {row.name: row.per_alignment_test for row in rows}
    assert {name for name, test in tests.items() if test is not None} == {"BL-60"}
    assert tests["BL-60"] is not None
    assert tests["BL-60"].p_corrected == tests["BL-60"].p


def test_the_control_without_the_term_is_less_diverse(results: EnqueryResults) -> None:
    control, with_term = (nearest_cell(results.sweep, kappa, 50) for kappa in (0.0, PRINTED["kappa"]))
    assert control.diversity < with_term.diversity


def test_another_configuration_is_another_task_of_work() -> None:
    def keys(budget: EnqueryBudget, seed: int) -> set[str]:
        return {task.key for task in tasks_in(make_plan(budget, seed))}

    first = keys(TINY, 0)
    assert keys(TINY, 0) == first
    assert {key.partition("-")[0] for key in first - keys(replace(TINY, gate_scenes=7), 0)} == {"alignment"}
    shared = {key.partition("-")[0] for key in first & keys(TINY, 1)}
    assert shared == {"shipped_base", "shipped_ensemble"}


def test_a_seed_without_scenes_of_its_own_is_refused() -> None:
    with pytest.raises(ValueError, match="seed = 100"):
        make_plan(TINY, 100)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [((0.6, 0.7, 0.8), (0.5, 0.75, 0.9), 15), ((0.6, 0.7, 0.8), (0.7, 0.6, 0.9), 60), ((0.6, 0.7), (0.7, 0.7), None)],
)
def test_the_crossing_is_where_the_second_stays_above(
    first: tuple[float, ...], second: tuple[float, ...], expected: int | None
) -> None:
    assert crossing((5, 15, 60)[: len(first)], first, second) == expected


@pytest.mark.parametrize("config", [BaseConfig("open_field", seed=7), PolicyEnsembleConfig(kappa=0.5)])
def test_settings_are_stored_under_their_first_names_and_read_again(config) -> None:
    """A task is named by a hash of its settings: what was computed before settings were renamed is found again."""
    stored = json.loads(json.dumps(config.as_dict()))
    assert type(config)(**read_config(stored)) == config
    assert ("calm_updates" in stored) == isinstance(config, BaseConfig)


@pytest.mark.parametrize(
    "config", [FineTuningConfig(updates=9, gate=GateRule(scenes=7)), thesis_config(seed=2, epochs=1)]
)
def test_settings_of_both_alignments_are_stored_as_when_they_were_one_and_read_again(config: RelabellingConfig) -> None:
    stored = json.loads(json.dumps(stored_alignment(config)))
    assert read_alignment(stored) == config
    assert stored["recipe"] in ("refine", "thesis")
    assert {"preference_weight", "preference_share", "gate_scenes", "gate_max_loss"} < set(stored)


def test_tasks_keep_the_names_that_finished_work_has_on_disk() -> None:
    plan = make_plan(BUDGETS["full"], 0)
    assert plan.base.key == "train_base-93b89aa660c36342536f"
    assert plan.ensemble.key == "train_ensemble-ca15404ac9227dd804f2"
