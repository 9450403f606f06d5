"""After every answer people may see how the robot would drive now: a condition of its own, nothing blind beside it."""

from __future__ import annotations

import csv

import pytest

from desirepath.grammar.source import ProtocolError
from desirepath.store.dataset.writing import export_study
from desirepath.study.refusals import Refused
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from tests.study.small_protocol import BLOCK, small_protocol
from tests.study.walking import answer

SHOWING = {"block": {"view": "top_down", "feedback": {}, "trials": [{"queries": {"count": 2}}]}}
SCALE = {"question": {"en": "Well?"}, "low": {"en": "no"}, "high": {"en": "yes"}}
PRACTISED = {
    "block": {
        "view": "first_person",
        "feedback": {"view": "top_down"},
        "trials": [{"queries": {"count": 1, "role": "practice"}}, {"queries": {"count": 2}}],
    }
}
TRAIN = {"train": {"job": "align"}}
COMPARISON = {"comparison": {"arms": ["base", "own"]}}
TUNING = {"tuning": {"start": "learned"}}


def test_after_every_regular_answer_the_robot_is_shown_as_it_has_learned_until_then(walk):
    walker = walk(SHOWING, TUNING)
    for number in (1, 2):
        key = walker.view.key
        walker.watch(key)
        walker.submit(key, {"choice": "a"})
        assert walker.view.kind == "feedback"
        assert (walker.view.payload["number"], walker.view.payload["answers"]) == (number, number)
        shown = walker.view.key
        walker.submit(shown, {"watched": True, "seconds": 6.25})
        value = answer(walker, shown).value
        assert (value["after"], value["answers"], value["watched"], value["seconds"]) == (key, number, True, 6.25)
        assert value["weights"]
    assert walker.view.kind == "tuning"
    assert walker.view.payload["start"] == value["weights"]


def test_practice_is_not_learned_from_so_nothing_is_shown_after_it(walk):
    walker = walk(PRACTISED)
    kinds = []
    while walker.view.kind in ("trial", "feedback"):
        key, kind = walker.view.key, walker.view.kind
        kinds.append(kind)
        if kind == "trial":
            walker.watch(key)
        walker.submit(key, {"choice": "a"} if kind == "trial" else {})
    assert kinds == ["trial", "trial", "feedback", "trial", "feedback"]


def test_a_time_that_cannot_be_is_refused(walk):
    walker = walk(SHOWING)
    key = walker.view.key
    walker.watch(key)
    walker.submit(key, {"choice": "b"})
    with pytest.raises(Refused) as refused:
        walker.submit(walker.view.key, {"seconds": -1})
    assert refused.value.field == "value.seconds"


@pytest.mark.parametrize(
    ("stages", "said"),
    [
        ([SHOWING, BLOCK], r"block.feedback: .*blind answers, to which nothing was shown"),
        ([SHOWING, {"rating": {"view": "top_down", "count": 2, "scale": SCALE}}], r"feedback: .*blind answers"),
        ([SHOWING, TRAIN, COMPARISON], r"block.feedback: .*a blind comparison of robots"),
        ([{"block": SHOWING["block"] | {"feedback": {"setup": "open_field"}}}], "must be study_room"),
    ],
)
def test_what_was_learned_is_never_shown_in_a_study_with_anything_blind(tmp_path, stages, said):
    with pytest.raises(ProtocolError, match=said):
        small_protocol(tmp_path, stages)


def test_the_export_says_after_which_answer_which_robot_was_shown(database, files, tmp_path, twenty_queries):
    frozen = small_protocol(tmp_path, [SHOWING], query_set=str(twenty_queries))
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Shown", created_by=None)
    assert walk_in_process(database, files, study, 1, Character())["completed"] == 1
    export_study(database, files, study.id, tmp_path / "out")
    with (tmp_path / "out" / "responses.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["kind"] == "feedback"]
    assert len(rows) == 2
    assert all('"after"' in row["value"] and '"weights"' in row["value"] for row in rows)
