"""The success gate: one rule, one verdict, for aligned policies and for what was learned from demonstrations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from desirepath.analysis.estimates import Estimate
from desirepath.learning.alignment.gate import BesideInstant, GateRule, at_gate, decide, surely_better, verdict
from desirepath.learning.cards import SOCIAL
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_policy
from desirepath.learning.preferences.sureness import Sureness

RULE = GateRule(scenes=30)


@pytest.fixture(scope="module")
def base() -> Policy:
    return load_policy("study_room/base")


def test_the_gate_stops_a_policy_that_does_not_arrive(base: Policy) -> None:
    shaken = Policy(base.setup, base.shape, (*base.actor[:-1], base.actor[-1] + np.array([-9, 9], dtype=np.float32)))
    assert not at_gate(shaken, base, RULE, seed=0).passed
    assert at_gate(base, base, RULE, seed=0).passed


def test_the_gate_says_the_fields_social_metrics_of_its_scenes_and_one_of_before_them_none(base: Policy) -> None:
    gate = at_gate(base, base, RULE, seed=0)
    assert gate.social is not None
    assert tuple(gate.social) == SOCIAL
    assert gate.social["spl"] == pytest.approx(gate.success_rate, abs=0.2)
    assert gate.as_dict()["social"] == gate.social
    assert "social" not in verdict(RULE, 0.95, scenes=70).as_dict()


def test_the_gate_drives_a_policy_with_its_recovery(base: Policy) -> None:
    still = tuple(np.zeros_like(array) for array in base.actor)
    stuck = Policy(base.setup, base.shape, (*still[:-1], np.array([-9, 0], dtype=np.float32)))
    assert at_gate(stuck, base, RULE, seed=0).success_rate == 0
    assert at_gate(replace(stuck, recovery_policies=(base.actor,)), base, RULE, seed=0).success_rate > 0


@pytest.mark.parametrize(
    ("own", "of_base", "passed"),
    [(0.95, 0.98, True), (0.93, 0.98, True), (0.92, 0.98, False), (0.89, 0.90, False), (0.90, None, True)],
)
def test_enough_success_and_not_much_less_than_the_base_policys(own: float, of_base: float, passed: bool) -> None:
    gate = verdict(GateRule(), own, of_base, scenes=500)
    assert gate.passed is passed
    assert (gate.min_success, gate.max_loss, gate.base_success_rate) == (0.90, 0.05, of_base)


def test_a_rule_is_stored_flat_beside_other_settings() -> None:
    rule = GateRule(scenes=70, min_success=0.8, max_loss=0.1)
    assert rule.as_dict() == {"gate_scenes": 70, "gate_min_success": 0.8, "gate_max_loss": 0.1}
    assert GateRule.of({"seed": 3, **rule.as_dict()}) == rule
    assert GateRule.of({}) == GateRule()


@pytest.mark.parametrize(
    ("success", "preferred", "score", "surely", "why"),
    [
        (0.95, None, None, None, "passed"),
        (0.95, -0.07, 0.01, True, "passed"),
        (0.80, 0.1, 0.1, False, "gate_not_passed"),
        (0.95, -0.08, 0.1, True, "not_better_than_instant"),
        (0.95, 0.1, -0.01, None, "not_better_than_instant"),
        (0.95, None, None, False, "not_surely_better"),
        (0.95, 0.1, 0.1, False, "not_surely_better"),
    ],
)
def test_one_function_decides_from_what_was_measured(success, preferred, score, surely, why) -> None:
    gate = verdict(GateRule(), success, 0.95, scenes=500)
    beside = None
    if preferred is not None:
        beside = BesideInstant(*(Estimate(low + 1, low, low + 2) for low in (preferred, score)))
    decision = decide(gate, beside_instant=beside, surely=surely)
    assert (decision.passed, decision.why) == (why == "passed", why)


@pytest.mark.parametrize(
    ("better", "clearly", "needed", "enough"),
    [(0.9, 0.85, 0.9, True), (0.89, 0.99, 0.9, False), (0.99, 0.84, 0.9, False), (0.5, 0.0, 0.5, True)],
)
def test_what_is_sure_enough_for_one_person(better, clearly, needed, enough) -> None:
    assert surely_better(Sureness(better, clearly), needed) is enough
