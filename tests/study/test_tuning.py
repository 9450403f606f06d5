"""Weights by hand: the final vector is the answer, every change on the way there is kept, replayed and exported."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest

from desirepath.grammar.source import ProtocolError
from desirepath.learning.preferences.objectives import OPPOSITES, names_of
from desirepath.simulation.setups import setups_with
from desirepath.store.dataset.writing import export_study
from desirepath.study.kinds.live import (
    controls_of,
    crowd_setups,
    distance,
    in_triangle,
    objectives_on,
    replay,
)
from desirepath.study.kinds.tuning import STARTED_RANDOMLY
from desirepath.study.personalising.live_rollouts import condition_on, path_of, roll_out, scenes_of
from desirepath.study.refusals import Refused
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from tests.study.small_protocol import BLOCK, small_protocol
from tests.study.walking import answer

TUNING = {"tuning": {"scenes": 2}}
COMPARED = [{"train": {"job": "align"}}, {"comparison": {"arms": ["base", "own"]}}]


def change(objective, weight, *, seconds=1.0, place=0, by="mouse"):
    return {"seconds": seconds, "place": place, "by": by, "objective": objective, "weight": weight}


@pytest.mark.parametrize("setup", setups_with("conditioned"))
def test_sliders_hold_all_weights_that_can_be_followed_with_opposites_on_one_slider(setup):
    names = names_of(setup)
    follows = set(names)
    if setup in crowd_setups():
        results = json.loads(Path(f"datasets/{setup}/conditioned.card.json").read_text())["results"]
        follows = {name for name, of in results["moved"].items() if of["share_of_the_way"]["low"] > 0.02}
    assert set(objectives_on(setup)) == follows
    pairs = {frozenset(control) for control in controls_of(setup) if len(control) == 2}
    assert pairs == {frozenset((names[a], names[b])) for a, b in OPPOSITES if {names[a], names[b]} <= follows}


def test_among_people_who_walk_other_weights_are_set_than_beside_one(walk):
    corners = ["waits", "passes_behind", "faster"]
    walker = walk(
        {"tuning": {"scenes": 1, "setup": "crowd_hall", "start": "random"}},
        {"tuning": {"scenes": 1, "setup": "crowd_hall", "objectives": corners}},
        BLOCK,
    )
    payload = walker.view.payload
    assert payload["among_people"]
    assert set(payload["start"]) <= set(objectives_on("crowd_hall"))
    with pytest.raises(Refused, match="no objective; known are closer, farther, passes_behind"):
        walker.submit("tuning", {"weights": {"clearance": 1.0}})
    history = [change(name, 0.0) for name in payload["start"]] + [change("waits", 1.0), change("passes_behind", 0.6)]
    walker.submit("tuning", {"weights": {"passes_behind": 0.6, "waits": 1.0}, "history": history})
    assert answer(walker, "tuning").value["weights"] == {"passes_behind": 0.6, "waits": 1.0}
    assert walker.view.payload["triangle"] == corners


@pytest.mark.parametrize("setup", setups_with("conditioned"))
def test_weights_move_the_robot_in_every_place_and_it_goes_on_from_where_it_is(setup):
    for scene in scenes_of(setup):
        usual, far = (roll_out(condition_on(setup, weights), scene) for weights in ({}, {"farther": 1.0}))
        assert path_of(usual).arrives
        assert path_of(far).arrives
        assert path_of(usual).track != path_of(far).track
        half = len(far.poses) // 2
        middle = far.poses[half].tolist()
        onward = path_of(roll_out(condition_on(setup, {"faster": 1.0}), scene, middle, float(far.times[half])))
        assert onward.track[0][1:3] == pytest.approx(middle[:2], abs=1e-3)
        goes_on = roll_out(condition_on(setup, {"farther": 1.0}), scene, middle, float(far.times[half]))
        assert goes_on.duration_s == pytest.approx(far.duration_s - far.times[half], abs=0.4), "nobody walks elsewhere"


def test_the_answer_is_the_final_vector_with_its_history(walk):
    walker = walk(TUNING, BLOCK)
    assert walker.view.payload["start"] == {}
    history = [change("farther", 0.3), change("farther", 0.8), change("closer", 0.4), change("smoother", 1.0)]
    with pytest.raises(Refused, match=r"history lead to 0\.4"):
        walker.submit("tuning", {"weights": {"farther": 0.8, "smoother": 1.0}, "history": history})
    walker.submit("tuning", {"weights": {"closer": 0.4, "smoother": 1.0}, "history": history})
    value = answer(walker, "tuning").value
    assert (value["start"], value["weights"]) == ({}, {"closer": 0.4, "smoother": 1.0})
    assert replay(value["start"], value["history"]) == value["weights"]


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ({"weights": {"farther": 1.2}}, "value.weights.farther.*from 0 to 1"),
        ({"weights": {"kinder": 0.2}}, "no objective; known are"),
        ({"weights": {"farther": 0.5, "closer": 0.5}}, "its opposite"),
        ({"weights": {}, "history": [change("kinder", 0.1)]}, "value.history.0.objective"),
        ({"weights": {}, "history": [change("faster", 2)]}, "value.history.0.weight"),
        ({}, "value.weights"),
    ],
)
def test_what_no_slider_can_say_is_refused_by_its_field(walk, value, said):
    walker = walk(TUNING, BLOCK)
    with pytest.raises(Refused) as refused:
        walker.submit("tuning", value)
    assert re.search(said, f"{refused.value.field}: {refused.value}")


CORNERS = ["farther", "shorter", "smoother"]
TRIANGLE = {"tuning": {"scenes": 2, "objectives": CORNERS}}


def test_a_triangle_of_three_weights_that_the_protocol_names_begins_in_its_middle(walk):
    walker = walk(TRIANGLE, BLOCK)
    payload = walker.view.payload
    assert payload["triangle"] == CORNERS
    assert payload["start"] == pytest.approx({"farther": 0.34, "shorter": 0.33, "smoother": 0.33}, abs=0.011)
    moved = {"farther": 0.7, "shorter": 0.1, "smoother": 0.2}
    history = [change(name, weight, by="touch") for name, weight in moved.items()]
    walker.submit("tuning", {"weights": moved, "history": history})
    assert answer(walker, "tuning").value["weights"] == moved


@pytest.mark.parametrize(
    ("weights", "said"),
    [
        ({"farther": 0.7, "shorter": 0.1}, "value.weights.*must sum to 1"),
        ({"farther": 0.7, "faster": 0.3}, "value.weights.faster.*no corner"),
    ],
)
def test_what_no_place_in_the_triangle_says_is_refused(walk, weights, said):
    walker = walk(TRIANGLE, BLOCK)
    with pytest.raises(Refused) as refused:
        walker.submit("tuning", {"weights": weights})
    assert re.search(said, f"{refused.value.field}: {refused.value}")


def test_shares_of_a_triangle_are_whole_percent_and_together_all():
    for weights in (
        {},
        {"farther": 0.1, "smoother": 0.2},
        {"closer": 1.0},
        {"shorter": 1, "farther": 1, "smoother": 1},
    ):
        found = in_triangle(weights, CORNERS)
        assert sum(found.values()) == pytest.approx(1)
        assert all(round(100 * share) == pytest.approx(100 * share) for share in found.values())
    assert in_triangle({"farther": 0.1, "smoother": 0.1}, CORNERS) == {"farther": 0.5, "smoother": 0.5}


def test_a_random_place_in_the_triangle_is_kept_and_bots_set_what_they_would_of_the_three(walk):
    walker = walk({"tuning": {"start": "random", "objectives": CORNERS}}, BLOCK)
    start = walker.view.payload["start"]
    assert set(start) <= set(CORNERS)
    assert sum(start.values()) == pytest.approx(1)
    walker.submit("tuning", {"weights": start})
    assert answer(walker, "tuning").value["start"] == start


def test_a_random_start_is_drawn_once_and_kept_with_the_answer(walk):
    walker = walk({"tuning": {"start": "random"}}, BLOCK)
    start = walker.view.payload["start"]
    assert len(start) == STARTED_RANDOMLY
    assert walker.view.payload["start"] == start
    walker.submit("tuning", {"weights": start})
    assert answer(walker, "tuning").value["start"] == start


def test_a_learned_start_is_what_the_answers_before_it_taught(walk):
    walker = walk(BLOCK, {"tuning": {"start": "learned"}})
    for _ in range(2):
        key = walker.view.key
        walker.watch(key)
        walker.submit(key, {"choice": "a"})
    start = walker.view.payload["start"]
    assert start
    assert max(start.values()) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("stages", "said"),
    [
        ([{"tuning": {"start": "learned"}}, BLOCK], "nothing learned yet"),
        ([BLOCK, {"tuning": {"start": "learned"}}, *COMPARED], "before the blind comparison"),
        ([BLOCK, {"tuning": {"start": "learned", "setup": "open_field"}}], "must be study_room"),
        ([BLOCK, {"tuning": {"scenes": 7}}], "6"),
        ([BLOCK, {"tuning": {"objectives": ["farther", "shorter"]}}], "names 2 objectives; a triangle has three"),
        ([BLOCK, {"tuning": {"objectives": ["farther", "closer", "faster"]}}], "of which only one may be above 0"),
        ([BLOCK, {"tuning": {"objectives": ["waits", "farther", "faster"]}}], "'waits' is no objective"),
        ([BLOCK, {"words": {"setup": "crowd_hall"}}], "words.*setup"),
        ([BLOCK, {"tuning": {"objectives": ["farther", "kinder", "faster"]}}], "'kinder' is no objective"),
    ],
)
def test_a_protocol_whose_learned_start_cannot_be_is_refused(tmp_path, stages, said):
    with pytest.raises(ProtocolError, match=said):
        small_protocol(tmp_path, stages)


def test_simulated_people_set_their_own_weights_and_the_export_has_every_change(
    database, files, tmp_path, twenty_queries
):
    stages = [{"tuning": {"start": "random"}}, TRIANGLE, BLOCK]
    frozen = small_protocol(tmp_path, stages, query_set=str(twenty_queries))
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Tuned", created_by=None)
    said = walk_in_process(database, files, study, 2, Character(oracle="shortest,min-human-distance"))
    assert said["completed"] == 2
    export_study(database, files, study.id, tmp_path / "out")
    with (tmp_path / "out" / "tuning_changes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["by"] for row in rows} == {"bot"}
    assert {("shorter", "1.0"), ("farther", "1.0")} <= {(row["objective"], row["weight"]) for row in rows}
    in_triangle_alone = [row for row in rows if row["step"] == "tuning_2"]
    assert {"smoother"} < {row["objective"] for row in in_triangle_alone} <= set(CORNERS)


def test_distance_is_of_whole_vectors():
    assert distance({"farther": 1.0}, {"farther": 0.4}) == pytest.approx(0.6)
    assert distance({}, {}) == 0
