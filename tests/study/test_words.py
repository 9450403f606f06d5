"""A wish in plain words as a step: read, asked back, corrected by hand; all of it stored, exported and erased."""

from __future__ import annotations

import csv
import json

import pytest

from desirepath.store.dataset.writing import export_study
from desirepath.store.erasure import erase_participant
from desirepath.store.models import Participant, Response
from desirepath.study.kinds.words import NO_WISH, SPOKEN
from desirepath.study.refusals import Refused
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from tests.study.small_protocol import BLOCK, small_protocol
from tests.study.test_tuning import change
from tests.study.walking import answer

WORDS = {"words": {"scenes": 2}}
SAID = "Stay well away from me but don't dawdle"


def by_words(**weights):
    return [change(name, weight, by="words") for name, weight in weights.items()]


def test_the_sentence_is_read_again_by_the_server_and_stored_with_its_correction(walk):
    walker = walk(WORDS, BLOCK)
    history = [*by_words(farther=1.0, faster=0.6), change("faster", 0.2, by="touch")]
    walker.submit("words", {"sentence": SAID, "weights": {"farther": 1.0, "faster": 0.2}, "history": history})
    value = answer(walker, "words").value
    assert value["sentence"] == SAID
    assert value["understood"] == {"farther": 1.0, "faster": 0.6}
    assert value["weights"] == {"farther": 1.0, "faster": 0.2}
    assert (value["corrected"], value["distance"]) == (True, pytest.approx(0.4))
    assert {(part["as"], part["objective"]) for part in value["marked"]} == {
        ("wanted", "farther"),
        ("wanted", "faster"),
    }


def test_what_was_meant_is_one_of_what_was_asked_back(walk):
    walker = walk(WORDS, BLOCK)
    with pytest.raises(Refused, match="must be one of farther"):
        walker.submit(
            "words", {"sentence": "Be careful", "meant": [{"question": 0, "objective": "faster"}], "weights": {}}
        )
    meant = [{"question": 0, "objective": "smoother"}]
    walker.submit(
        "words",
        {"sentence": "Be careful", "meant": meant, "weights": {"smoother": 0.8}, "history": by_words(smoother=0.8)},
    )
    value = answer(walker, "words").value
    assert value["understood"] == value["weights"] == {"smoother": 0.8}
    assert not value["corrected"]


@pytest.mark.parametrize(
    "value",
    [
        {"sentence": "x" * 301},
        {"sentence": None},
        {},
        {"sentence": "far", "meant": [{"question": 0, "objective": "x"}]},
    ],
)
def test_what_cannot_be_read_is_refused(walk, value):
    with pytest.raises(Refused):
        walk(WORDS, BLOCK).submit("words", {"weights": {}} | value)


def test_a_sentence_that_says_nothing_is_an_answer_of_no_weights(walk):
    walker = walk(WORDS, BLOCK)
    walker.submit("words", {"sentence": "Play some music", "weights": {}})
    assert answer(walker, "words").value["marked"] == [{"text": "Play some music", "as": "missed"}]


def test_bots_say_what_they_prefer_and_export_and_erasure_hold_every_word(database, files, tmp_path, twenty_queries):
    frozen = small_protocol(tmp_path, [WORDS, BLOCK], query_set=str(twenty_queries))
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Said", created_by=None)
    assert walk_in_process(database, files, study, 2, Character(oracle="shortest,min-human-distance"))["completed"] == 2
    export_study(database, files, study.id, tmp_path / "out")
    with (tmp_path / "out" / "responses.csv").open() as file:
        said = [json.loads(row["value"]) for row in csv.DictReader(file) if row["kind"] == "words"]
    assert {one["sentence"] for one in said} == {SPOKEN["en"]["shorter"], SPOKEN["en"]["farther"]}
    with (tmp_path / "out" / "tuning_changes.csv").open() as file:
        assert {row["by"] for row in csv.DictReader(file)} == {"words"}
    with database.session() as s:
        people = [one.id for one in s.query(Participant).all()]
    for person in people:
        erase_participant(database, files, person, "experimenter")
    with database.session() as s:
        assert not s.query(Response).filter(Response.kind == "words").all()
    assert NO_WISH.keys() == SPOKEN.keys()
