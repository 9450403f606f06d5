"""The ceiling of policies is the best that we have or can train for one preference, and never less than what we own."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from desirepath.installed import ROOT
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.shipped import load_conditioned, load_policy
from desirepath.learning.policies.steerability import Course
from desirepath.learning.preferences.measures import MEASURES
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.setups import PREFERENCE_SETUPS
from desirepath_experiments.benchmarks.headline import FIRST_REPORT_SEED, true_weights
from desirepath_experiments.benchmarks.policy_ceiling import (
    CeilingConfig,
    ExpertState,
    benchmark_ceiling,
    summarise,
    train_experts,
    way_to,
)
from desirepath_experiments.training.through_simulation.experts import (
    Candidate,
    ExpertConfig,
    Selection,
    best_of,
    converged,
    failed_rounds,
    trained_round,
    untrained,
)

TINY = ExpertConfig("study_room", round_steps=2, batch=6, selection_scenes=30, most_rounds=1)
FAR = "min-human-distance"


@pytest.fixture(scope="module")
def selection() -> Selection:
    return Selection(true_weights(FAR), load_policy("study_room/base"), TINY)


def test_training_ends_when_rounds_add_nothing_or_are_used_up() -> None:
    config = replace(TINY, most_rounds=4)
    assert not converged([0.1], config)
    assert not converged([0.1, 0.2], config)
    assert converged([0.1, 0.2, 0.204], config)
    assert not converged([0.1, 0.2, 0.204], replace(config, patience=2))
    assert converged([0.1, 0.2, 0.2, 0.204], replace(config, patience=2))
    assert converged([0.0, 0.1, 0.2, 0.3, 0.4], config)
    assert not converged([-0.1, -0.05], config)
    assert [failed_rounds(gained) for gained in ([0.1], [0.1, 0.1], [0.1, 0.2, 0.2], [0.1, 0.2])] == [0, 1, 1, 0]
    true = true_weights(FAR)
    assert config.training(true, 2, failed=1).learning_rate == config.learning_rate / 2
    slow = config.training(true_weights("left-and-slow"), 1)
    assert slow.most_steps > config.training(true, 1).most_steps


def test_who_arrives_too_rarely_is_no_ceiling(selection: Selection) -> None:
    base = load_policy("study_room/base")
    surely = Candidate("sure", base, 0.1, 0.98, may=True)
    assert best_of([Candidate("reckless", base, 3.0, 0.8, may=False), surely]) is surely
    stopped = replace(base, critic=(), actor=tuple(np.zeros_like(layer) for layer in base.actor))
    judged = selection.judged("turns on the spot", stopped)
    assert not judged.may
    assert judged.gained == 0.0
    assert selection.judged("base", base) == Candidate("base", base, 0.0, pytest.approx(0.98, abs=0.04), may=True)


def test_a_round_keeps_what_is_better_with_a_recovery_or_without(selection: Selection) -> None:
    far = load_conditioned("study_room/conditioned").at(np.eye(9, dtype=np.float32)[0])
    found = untrained({"conditioned": far, "base": load_policy("study_room/base")}, selection)
    assert found[0].name.startswith("conditioned")
    assert {one.name for one in found} == {"conditioned", "conditioned, no recovery", "base"}
    made = trained_round(found[0], true_weights(FAR), selection, TINY, 1, far.recovery_policies)
    assert made.gained >= found[0].gained


def test_a_stopped_run_goes_on_and_nothing_of_ours_beats_its_expert(tmp_path: Path) -> None:
    config = CeilingConfig(preferences=(FAR,), seeds=(3,), scenes=30, planned=6)
    assert not train_experts("study_room", tmp_path, {}, config, TINY, minutes=0)
    told: list[str] = []
    assert train_experts("study_room", tmp_path, {}, config, TINY, tell=told.append)
    assert len(told) == 1
    assert train_experts("study_room", tmp_path, {}, config, TINY, tell=told.append)
    assert len(told) == 1, "what was trained is not trained again"
    plans = tmp_path / "plans" / f"study_room_{FIRST_REPORT_SEED + 3}_{FAR}_6.npy"
    plans.parent.mkdir()
    np.save(plans, np.full(6, 50.0))  # far beyond what any policy gets
    result = benchmark_ceiling("study_room", tmp_path, {"shipped": load_conditioned("study_room/conditioned")}, config)
    (row,) = result["rows"]
    assert 0 < row["expert_share"] < 0.2
    assert 0.7 < row["shipped"]["share_true"] < 1.3
    assert result["summary"]["shipped"]["median_share"] == row["shipped"]["share"]
    of_starts = result["experts"][FAR]
    chosen = max(one["rounds"][-1]["gained"] for one in of_starts.values() if one["rounds"][-1]["may"])
    assert chosen >= max(one["rounds"][0]["gained"] for one in of_starts.values())
    with pytest.raises(LearningError, match="faces-person"):
        train_experts("study_room", tmp_path, {}, replace(config, preferences=("faces-person",)), TINY)


def test_a_rule_that_slows_down_beside_the_person_is_a_candidate_and_kept(tmp_path: Path) -> None:
    slow = "slow-near-person"
    config = CeilingConfig(preferences=(slow,))
    quick = replace(TINY, slow_batch=2, round_steps=1, selection_scenes=12)
    assert train_experts("study_room", tmp_path, {}, config, quick)
    kept = ExpertState(tmp_path / "study_room" / slow, "study_room")
    chosen = kept.chosen()
    rule = chosen.policy.slowing
    assert rule is not None
    assert f"slowed to {rule.most:g} within {rule.near_m:g} m" in kept.state["starts"]["slowed"]["rounds"][0]["name"]
    course = Course(scene_set("study_room", 12, purpose=Purpose.ALIGN_SELECT, seed=45))
    usual, limited = course.rollout(load_policy("study_room/base")), course.rollout(chosen.policy)
    k = MEASURES.index("speed_near_person_m_s")
    both = usual.success & limited.success
    assert limited.measured[both, k].mean() < 0.6 * usual.measured[both, k].mean()
    seen = np.zeros((2, 66), dtype=np.float32)
    seen[1, 2] = 1.0
    near, far = chosen.policy.act(seen)[:, 0]
    assert near <= 2 * rule.most - 1 + 1e-6
    assert far == pytest.approx(replace(chosen.policy, slowing=None).act(seen)[1, 0])
    state = tmp_path / "study_room" / slow / "state.json"
    before = json.loads(state.read_text(encoding="utf-8"))
    before["starts"]["slowed"]["rounds"][0]["limit"] = {"near_m": 1.7, "most": 0.4}  # as it was written down once
    state.write_text(json.dumps(before), encoding="utf-8")
    read = ExpertState(tmp_path / "study_room" / slow, "study_room").candidate("slowed").policy.slowing
    assert read is not None
    assert (read.near_m, read.most) == (1.7, 0.4)


def test_the_way_to_the_expert_is_of_where_all_three_arrive() -> None:
    course = Course(scene_set("study_room", 12, purpose=Purpose.ALIGN_SELECT, seed=44))
    base, far = (
        course.rollout(load_policy("study_room/base")),
        course.rollout(load_policy("study_room/conditioned@farther=1")),
    )
    true = true_weights(FAR)
    assert way_to(far, far, base, true, "study_room") == pytest.approx(1.0)
    assert way_to(base, far, base, true, "study_room") == 0.0
    assert math.isnan(way_to(far, base, base, true, "study_room")), "nothing is better than the base policy"
    none_else = replace(far, outcome=np.where(np.arange(12) < 2, far.outcome, 0).astype(np.int8))
    both = far.success & base.success & none_else.success
    assert both.sum() <= 2
    assert way_to(none_else, far, base, true, "study_room") == pytest.approx(1.0)


def test_the_worst_preference_is_by_its_median() -> None:
    rows = [
        {"preference": name, "seed": k, "expert_share": share, "success_expert": 0.98, "own": {"share": 2 * share}}
        for name, each in {"far": (0.9, 0.8, 0.7), "slow": (0.1, 0.3, 0.2)}.items()
        for k, share in enumerate(each)
    ]
    found = summarise(rows, ("own",))
    assert found["summary"]["expert"]["worst_preference"] == "slow"
    assert found["summary"]["expert"]["worst_share"] == pytest.approx(0.2)
    assert found["summary"]["own"]["median_share"] == pytest.approx(1.0)
    assert found["preferences"][1]["own"] == {"share": 0.4, "lowest": 0.2, "highest": 0.6}


def test_numbers_say_what_the_stored_runs_say_and_no_expert_is_called_better_than_it_arrives() -> None:
    readme, numbers = ((ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/numbers.md"))
    for setup in PREFERENCE_SETUPS:
        stored = json.loads(
            (ROOT / "experiments" / "results" / setup / "policy_ceiling.json").read_text(encoding="utf-8")
        )
        assert stored["command"].startswith(f"desirepath benchmark ceiling --setup {setup} --seeds 0-2")
        assert len(stored["rows"]) == 3 * 13
        for which in ("expert", "conditioned", "sharpened"):
            one = stored["summary"][which]
            assert f"{100 * one['median_share']:.0f} %; " in numbers
            assert f"{100 * one['worst_share']:.0f} % ({one['worst_preference']})" in numbers
        shipped = stored["summary"]["conditioned"]
        assert f"{100 * shipped['worst_share']:.0f} % ({shipped['worst_preference']})" in readme
        lowest = min(stored["preferences"], key=lambda line: float(line["success_expert"]))
        assert f"{100 * lowest['success_expert']:.1f} % ({lowest['preference']})" in numbers
        for starts in stored["experts"].values():
            first = [one["rounds"][0]["gained"] for one in starts.values() if one["rounds"][0]["may"]]
            last = [one["rounds"][-1]["gained"] for one in starts.values() if one["rounds"][-1]["may"]]
            assert max(last) >= max(first), "the ceiling is at least what we own"
