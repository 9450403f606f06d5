"""Rules that last as a step: told, drawn, ordered, looked at; all of it stored, exported and erased."""

from __future__ import annotations

import csv
import json

import pytest

from desirepath.learning.rules.reading import read_rule
from desirepath.report import tidy_tables
from desirepath.report.findings import analyse
from desirepath.report.tidy_tables import read_folder
from desirepath.store.dataset.writing import export_study
from desirepath.store.erasure import erase_participant
from desirepath.store.models import Participant, Response
from desirepath.study.kinds.rules import SPOKEN, obeyed_side
from desirepath.study.personalising.rule_pictures import driven_by, paths_of, picture, read
from desirepath.study.refusals import Refused
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from tests.study.small_protocol import BLOCK, small_protocol
from tests.study.walking import answer

RULES = {"rules": {"scenes": 3, "least": 1}}
FRONT, KITCHEN = "When I sit, keep behind me", "In the kitchen go slower"
TOLD = [{"seconds": 1.0, "do": "told", "rule": 0, "words": FRONT}]


def rule(sentence: str, **changed: object) -> dict[str, object]:
    return read_rule(sentence, "en").rule.model_dump(mode="json") | changed


def test_rules_are_stored_with_their_history_and_what_was_picked(walk):
    walker = walk(RULES, BLOCK)
    rules = [rule(FRONT), rule(KITCHEN, on=False)]
    moved = [*TOLD, {"seconds": 9.0, "do": "moved", "rule": 1}]
    side = obeyed_side(walker.session.id, read_rule(FRONT, "en").rule, 0)
    picked = [{"rule": 0, "place": 0, "side": side}]
    walker.submit("rules", {"rules": rules, "history": moved, "picked": picked})
    value = answer(walker, "rules").value
    assert [one["on"] for one in value["rules"]] == [True, False]
    assert value["read"] == [True, True]
    assert value["edits"] == 1
    assert value["picked"] == [{"rule": 0, "place": 0, "shown": "obeyed"}]


def test_a_rule_switched_off_after_its_pick_keeps_what_was_picked(walk):
    walker = walk(RULES, BLOCK)
    told = [read_rule(FRONT, "en").rule.model_copy(update={"words": FRONT + "." * many}) for many in range(12)]
    picked = [
        {"rule": number, "place": 0, "side": obeyed_side(walker.session.id, one, 0)} for number, one in enumerate(told)
    ]
    off = [one.model_dump(mode="json") | {"on": False} for one in told]
    walker.submit("rules", {"rules": off, "picked": picked})
    assert {one["shown"] for one in answer(walker, "rules").value["picked"]} == {"obeyed"}


@pytest.mark.parametrize(
    "value",
    [
        {"rules": []},
        {"rules": [{"words": "Not here", "zones": [{"kind": "here"}]}]},
        {"rules": [{"words": "x", "wishes": [{"objective": "louder"}]}]},
        {"rules": [rule(FRONT)] * 13},
        {"rules": [rule(FRONT)], "picked": [{"rule": 1, "place": 0, "side": "a"}]},
    ],
)
def test_what_is_no_rule_is_refused(walk, value):
    with pytest.raises(Refused):
        walk(RULES, BLOCK).submit("rules", value)


def test_a_page_is_shown_where_a_rule_applies_and_both_ways():
    sitting = read_rule(FRONT, "en").rule
    shown = picture([sitting, read_rule("When guests are here, come closer", "en").rule], 0)
    assert len(shown["shown"][0]["zones"]) == 1
    assert shown["shown"][1]["unavailable"] == ["others"]
    pair = paths_of(sitting, 0)
    assert pair is not None
    assert pair[0].track != pair[1].track
    assert read("Not here", "en")["asked"] == [{"about": "place", "text": "here", "offered": []}]


def test_the_same_rule_in_other_words_is_driven_once():
    one = read_rule(FRONT, "en").rule
    assert driven_by([one], 0) is driven_by([one.model_copy(update={"words": "Mind my knees"})], 0)


def test_what_an_imported_data_set_has_that_is_no_rule_is_passed_over():
    value = {"rules": [{"whenever": []}, rule(FRONT)], "read": [False, True], "picked": [], "edits": 0}
    row = {"kind": "rules", "value": value, "session": "s", "step": "rules", "participant": "p"}
    (told,) = tidy_tables._told_rules([row], {})
    assert ([one.words for one in told.rules], told.read) == ([FRONT], [True])


def test_simulated_participants_tell_rules_which_are_exported_and_erased(database, files, tmp_path, twenty_queries):
    frozen = small_protocol(tmp_path, [RULES, BLOCK], query_set=str(twenty_queries))
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Ruled", created_by=None)
    assert walk_in_process(database, files, study, 2, Character(oracle="min-human-distance"))["completed"] == 2
    export_study(database, files, study.id, tmp_path / "out")
    with (tmp_path / "out" / "responses.csv").open() as file:
        told = [json.loads(row["value"]) for row in csv.DictReader(file) if row["kind"] == "rules"]
    assert {one["rules"][0]["words"] for one in told} == {SPOKEN["en"][0]}
    told, load = read_folder(tmp_path / "out")
    found = analyse(told, load, "simulated").ruled
    assert found is not None
    assert (found.people, found.told.n) == (2, 2)
    assert 0 < found.obeyed.mean <= 1
    assert 0 < found.arrived.mean <= 1
    with database.session() as s:
        people = [one.id for one in s.query(Participant).all()]
    for person in people:
        erase_participant(database, files, person, "experimenter")
    with database.session() as s:
        assert not s.query(Response).filter(Response.kind == "rules").all()
