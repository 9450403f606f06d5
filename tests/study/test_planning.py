"""The plan of a session: seeded, fair to both sides, and what spec 07 asks for."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desirepath.installed import PROTOCOLS
from desirepath.study.kind import dump_plan
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.protocol.planning import PlanError, make_plan, session_seed

TEXT = (PROTOCOLS / "quick_preference_study.yaml").read_text().replace("choose: information", "choose: random")
QUICK = freeze_text(TEXT).protocol


@dataclass(frozen=True)
class AQuery:
    id: str
    setup: str = "study_room"
    scene_hash: str = ""
    trajectory_a: str = ""
    trajectory_b: str = ""
    duration_a_s: float = 5.0
    duration_b_s: float = 6.0


QUERIES = [AQuery(f"q{i}", scene_hash=f"s{i}", trajectory_a=f"q{i}a", trajectory_b=f"q{i}b") for i in range(40)]


def planned(*asked):
    """A plan as it is stored."""
    return dump_plan(make_plan(*asked))


def trials(plan):
    return [step for step in plan if step["kind"] == "trial"]


def test_the_quick_study_step_by_step():
    plan = planned(QUICK, 1, QUERIES)
    kinds = [step["kind"] for step in plan]
    assert kinds == [
        *("information", "consent", "questionnaire", "instruction"),
        *["trial"] * 16,
        *("questionnaire", "wait"),
        *["comparison"] * 6,
        *("guess", "meet_your_robot", "debriefing"),
    ]
    assert Counter(step["role"] for step in trials(plan)) == {"practice": 1, "regular": 15}
    assert trials(plan)[0]["role"] == "practice"
    assert [step["number"] for step in trials(plan)] == [1, *range(1, 16)]
    assert [step["key"] for step in plan if step.get("then") == "train"] == ["block.16"]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31 - 1))
def test_no_query_is_shown_twice_and_keys_are_unique(seed):
    plan = planned(QUICK, seed, QUERIES)
    assert len({step["key"] for step in plan}) == len(plan)
    assert len({step["query"] for step in trials(plan)}) == 16
    for step in trials(plan):
        sides = (step["trajectory_a"], step["trajectory_b"])
        straight = (f"{step['query']}a", f"{step['query']}b")
        assert sides == (straight[::-1] if step["sides_swapped"] else straight)
        assert step["duration_a_s"] == (6.0 if step["sides_swapped"] else 5.0)


def test_the_same_seed_gives_the_same_plan_and_another_another():
    assert planned(QUICK, 5, QUERIES) == planned(QUICK, 5, QUERIES)
    assert planned(QUICK, 5, QUERIES) != planned(QUICK, 6, QUERIES)
    assert session_seed(7, "P-AAAAA") == session_seed(7, "P-AAAAA") != session_seed(8, "P-AAAAA")


def test_sides_are_drawn_evenly_over_participants():
    plans = [planned(QUICK, session_seed(7, f"P{i}"), QUERIES) for i in range(200)]
    turned = [step["sides_swapped"] for plan in plans for step in trials(plan)]
    assert 0.45 < sum(turned) / len(turned) < 0.55
    own_is_a = [step["sides_swapped"] for plan in plans for step in plan if step["kind"] == "comparison"]
    assert 0.42 < sum(own_is_a) / len(own_is_a) < 0.58


def test_probes_ask_again_as_they_were_and_with_sides_changed():
    protocol = freeze_text(TEXT.replace("choose: random}", "choose: random, probes: {repeat: 2, swap: 3}}")).protocol
    steps = trials(planned(protocol, 3, QUERIES))
    roles = [step["role"] for step in steps]
    assert Counter(roles) == {"practice": 1, "regular": 15, "repeat": 2, "swap": 3}
    assert set(roles[-5:]) == {"repeat", "swap"}
    first = {step["query"]: step for step in steps if step["role"] == "regular"}
    for probe in steps[-5:]:
        asked = first[probe["query"]]
        assert (probe["sides_swapped"] == asked["sides_swapped"]) == (probe["role"] == "repeat")
    assert len({probe["query"] for probe in steps[-5:]}) == 5


def test_two_blocks_show_the_same_queries_with_the_same_sides_in_their_own_order():
    block = "  - block:\n      view: immersive\n      trials: [{queries: {count: 15}}]\n"
    one = TEXT.replace(
        "        - queries: {count: 1, role: practice}     # for practice: stored, marked, never analysed\n", ""
    )
    protocol = freeze_text(one.replace("  # In each scene", block + "  # In each scene")).protocol
    steps = trials(planned(protocol, 3, QUERIES))
    above = [step for step in steps if step["view"] == "top_down"]
    there = [step for step in steps if step["view"] == "immersive"]
    assert {(s["query"], s["sides_swapped"]) for s in above} == {(s["query"], s["sides_swapped"]) for s in there}
    assert [s["query"] for s in above] != [s["query"] for s in there]


def test_too_few_queries_are_refused_with_the_number_needed():
    with pytest.raises(PlanError, match="has 15 queries, one session of this protocol needs 16"):
        planned(QUICK, 1, QUERIES[:15])


def test_without_a_comparison_nobody_waits_for_the_training():
    lines = [line for line in TEXT.splitlines(keepends=True) if "- comparison" not in line and "- meet" not in line]
    plan = planned(freeze_text("".join(lines)).protocol, 1, QUERIES)
    assert "wait" not in {step["kind"] for step in plan}
    assert any(step.get("then") == "train" for step in plan)
