"""Several ways to say how the robot should drive: each results in a robot, and the robots are compared blind."""

from __future__ import annotations

import json
from collections import Counter
from itertools import combinations, pairwise

import pytest
from sqlalchemy import select

from desirepath.installed import PROTOCOLS
from desirepath.learning.preferences.from_paths import WeightsOfPaths, shipped_weights_of_paths
from desirepath.simulation.demonstration_scenes import demonstration_scene
from desirepath.store.models import Response, Session, StrokeRow, Trial, utc_now
from desirepath.study.kind import Moment
from desirepath.study.personalising.about_person import about_person
from desirepath.study.personalising.method_robots import METHODS
from desirepath.study.plan.counterbalancing import design_of
from desirepath.study.protocol.freezing import ProtocolError, freeze, validate_protocol_file
from desirepath.study.protocol.planning import example_queries, make_plan
from desirepath.study.refusals import Refused
from desirepath.study.session.versions import protocol_of
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from tests.study.small_protocol import BLOCK, small_protocol

SHIPPED = PROTOCOLS / "adaptable_study.yaml"
FEW = {
    "methods": {
        "choices": [{"queries": {"count": 2}}],
        "drawing": {"paths": 1},
        "scenes": 1,
    }
}
COMPARED = {"method_comparison": {"scenes": 1}}
ASKED = {"questionnaire": {"use": "ways"}}


@pytest.fixture(scope="module")
def frozen():
    return freeze(SHIPPED)


def plan_of(frozen, row):
    return make_plan(frozen.protocol, 1, example_queries(frozen.protocol), design_of(frozen.protocol).rows[row])


def test_the_shipped_protocol_asks_all_four_methods_in_four_balanced_orders(frozen):
    rows = design_of(frozen.protocol).rows
    orders = [tuple(one.name for one in row["methods"].conditions(frozen.protocol.stages[3].stage)) for row in rows]
    assert {frozenset(order) for order in orders} == {frozenset(METHODS)}
    followed = [pair for order in orders for pair in pairwise(order)]
    assert len(followed) == len(set(followed)) == 12  # every method right after every other, once


def test_every_method_ends_in_its_task_load(frozen):
    steps = plan_of(frozen, 0)
    for method in METHODS:
        mine = [step for step in steps if step.block == method]
        assert (mine[0].kind, mine[-1].kind) in {("instruction", "questionnaire"), ("break", "questionnaire")}
        assert sum(step.kind == "questionnaire" for step in mine) == 1


def test_every_two_robots_meet_in_the_same_scenes_in_an_order_of_each_ones_own(frozen):
    one, other = ([step for step in plan_of(frozen, row) if step.kind == "method_comparison"] for row in (0, 1))
    met = [(frozenset((step.first, step.second)), step.place) for step in one]
    assert sorted(met, key=str) == sorted(
        ((frozenset(pair), place) for pair in combinations(METHODS, 2) for place in range(2)), key=str
    )
    assert {step.sides_swapped for step in one} == {True, False}
    assert not any(method in step.key for step in (*one, *other) for method in METHODS)


@pytest.mark.parametrize(
    ("stages", "message"),
    [
        ([COMPARED], "needs a methods stage before it"),
        ([BLOCK, FEW], "cannot stand beside blocks"),
        ([{"methods": {"methods": ["words", "words"]}}], "has a method twice"),
        ([{"methods": {"setup": "open_field"}}], "must be study_room, where paths can be drawn"),
        ([{"methods": {"methods": ["words", "guessing"]}}], "guessing"),
    ],
)
def test_what_cannot_be_is_refused_with_its_line(tmp_path, twenty_queries, stages, message):
    with pytest.raises(ProtocolError, match=message):
        small_protocol(tmp_path, stages, query_set=str(twenty_queries))


def test_the_shipped_protocol_is_valid():
    assert validate_protocol_file(SHIPPED) == {"valid": True, "errors": []}


@pytest.fixture
def walked(tmp_path, database, files, twenty_queries):
    """A study of two simulated participants who prefer room above all."""
    with database.transaction() as s:
        frozen = small_protocol(tmp_path, [FEW, COMPARED, ASKED], query_set=str(twenty_queries))
        study = create_study(s, files, frozen, name="Methods", created_by=None)
    done = walk_in_process(database, files, study, 1, Character(oracle="min-human-distance"))
    assert (done["completed"], done["comparisons"]) == (1, 6)
    with database.session() as s:
        yield s, study


def test_each_method_results_in_a_robot_and_the_answers_say_which_was_chosen(walked):
    s, _ = walked
    answers = [one.value for one in s.scalars(select(Response).where(Response.kind == "method_comparison"))]
    weights = {}
    for value in answers:
        for side, method in value["methods"].items():
            weights.setdefault(method, []).append(json.dumps(value["weights"][side], sort_keys=True))
    assert set(weights) == set(METHODS)
    assert all(len(set(of)) == 1 for of in weights.values())  # one robot of each method
    assert json.loads(weights["words"][0]) == {"farther": 1.0}
    assert json.loads(weights["sliders"][0]) == {"farther": 1.0}
    assert json.loads(weights["choices"][0])
    assert json.loads(weights["drawing"][0])


def test_the_last_page_says_whose_robot_was_which_and_what_this_person_chose(walked):
    s, _ = walked
    session = s.scalars(select(Session)).one()
    ended = Moment(s, session, protocol_of(s, session), utc_now())
    about = about_person(ended)
    answered = [one.value for one in s.scalars(select(Response).where(Response.kind == "method_comparison"))]
    assert [(pair["a"], pair["b"], pair["choice"]) for pair in about["met"]] == [
        (value["methods"]["a"], value["methods"]["b"], value["choice"]) for value in answered
    ]
    chosen = Counter(pair[pair["choice"]] for pair in about["met"])
    assert {one["method"]: (one["chosen"], one["pairs"]) for one in about["methods"]} == {
        method: (chosen[method], 3) for method in METHODS
    }
    most = [method for method in METHODS if chosen[method] == max(chosen.values())]
    assert about["favourite"] == (most[0] if len(most) == 1 else None)
    foremost = {one["method"]: one["foremost"] for one in about["methods"]}
    assert foremost["sliders"] == foremost["words"] == "farther"
    said = [one.value for one in s.scalars(select(Response).where(Response.kind == "questionnaire"))]
    assert about["wanted"] == next(value["preference"][0] for value in said if "preference" in value)


def test_the_robots_drive_in_one_scene_and_no_page_says_which_is_whose(walked):
    s, _ = walked
    trials = s.scalars(select(Trial).where(Trial.kind == "method_comparison")).all()
    assert len(trials) == 6
    assert {frozenset((one.arms["a"], one.arms["b"])) for one in trials} == {
        frozenset(pair) for pair in combinations(METHODS, 2)
    }
    shown = {(one.arms[side], getattr(one, f"trajectory_{side}")) for one in trials for side in "ab"}
    assert len(shown) == 4  # each robot drives alike wherever it is shown
    assert s.scalars(select(StrokeRow.environment).where(StrokeRow.state == "kept")).all() == ["study_room"]


def test_a_sentence_that_cannot_be_corrected_is_taken_as_it_was_understood(walk):
    walker = walk({"words": {"scenes": 1, "correct": False}}, BLOCK)
    change = {"seconds": 0, "place": 0, "by": "words", "objective": "farther", "weight": 0.2}
    with pytest.raises(Refused, match="cannot be corrected here"):
        walker.submit("words", {"sentence": "Stay far away from me", "weights": {"farther": 0.2}, "history": [change]})


def test_the_candidates_that_paths_are_compared_with_are_of_the_scenes_that_are_drawn_in():
    shipped = shipped_weights_of_paths("study_room")
    assert shipped.measured.shape[1:] == (4, 7)
    assert WeightsOfPaths.from_bytes(shipped.to_bytes()).to_bytes() == shipped.to_bytes()
    scene = demonstration_scene("study_room", 2)
    assert scene.setup == "study_room"
