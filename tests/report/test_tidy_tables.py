"""Tables as exported become tidy rows: what is no choice and no rating does not become one."""

from __future__ import annotations

import json
from dataclasses import asdict
from datetime import UTC, datetime

import pytest
import yaml

from desirepath.analysis.scale_wordings import SCALES
from desirepath.report.study_data import StudyData
from desirepath.report.tidy_tables import tidy

FILES = {
    "questionnaires/usability.yaml": yaml.safe_dump({"title": {"en": "Usability"}, "blocks": [{"scale": "sus"}]}),
    "scales/sus.json": json.dumps(asdict(SCALES["sus"])),
}
PERSON = {"participant": "P-1", "simulated": False, "excluded": False, "excluded_reason": None, "withdrawn": False}
SESSION = {
    "session": "s",
    "device": {"pointer": "fine"},
    "participant": "P-1",
    "created_at": datetime(2026, 1, 1, tzinfo=UTC),
    "state": "completed",
    "plan": [{"key": "usability", "kind": "questionnaire", "stage": "usability", "questionnaire": "usability"}],
}


def trial(name: str) -> dict:
    return {
        "trial": name,
        "session": "s",
        "participant": "P-1",
        "kind": "query",
        "block": "block",
        "view": "top_down",
        "query": name,
        "role": "regular",
        "trajectory_a": "a",
        "trajectory_b": "b",
        "arms": None,
    }


def response(trial: str | None, choice: str | None, value: dict) -> dict:
    kind, step = ("preference", f"block.{trial}") if trial else ("questionnaire", "usability")
    return {
        "trial": trial,
        "participant": "P-1",
        "session": "s",
        "step": step,
        "kind": kind,
        "choice": choice,
        "value": value,
        "decision_s": 1.0,
        "device": None,
    }


def test_a_choice_whose_time_was_over_is_none_and_its_mark_no_rating() -> None:
    tables = {
        "participants": [PERSON],
        "sessions": [SESSION],
        "trials": [trial("1"), trial("2")],
        "responses": [
            response("1", "a", {"choice": "a"}),
            response("2", None, {"timed_out": True}),
            response(None, None, {"sus_1": 4, "timed_out": True}),
        ],
    }
    data = tidy("Study", "1", {}, "", FILES, tables)
    assert [(one.query, one.chosen) for one in data.choices] == [("1", "a")]
    assert data.choices[0].device == {"pointer": "fine"}  # of the session, where a data set does not tell
    tables["responses"][0]["device"] = {}  # given before any page told of a device
    assert tidy("Study", "1", {}, "", FILES, tables).choices[0].device == {}
    assert [(one.item, one.value) for one in data.ratings] == [("sus_1", 4)]
    scale = data.items
    assert [one.key for one in scale] == [one.key for one in SCALES["sus"].items]
    assert {one.points for one in scale} == {5}
    assert any(one.reversed for one in scale)
    assert data.scales == [("usability", SCALES["sus"])]


def test_what_was_asked_before_and_after_says_which_it_was() -> None:
    plan = [{**SESSION["plan"][0], "key": key, "stage": key} for key in ("usability", "usability_2")]
    given = [{**response(None, None, {"sus_1": k}), "step": step["key"]} for k, step in enumerate(plan, 4)]
    found = tidied([], given, session={"plan": plan}).ratings
    assert [(one.asking, one.value) for one in found] == [("usability", 4), ("usability_2", 5)]


def comparison(name: str, **arms: object) -> dict:
    return {**trial(name), "kind": "comparison", "query": None, "arms": {"a": "policy-a", "b": "policy-b", **arms}}


def tidied(trials: list[dict], responses: list[dict], **more: dict) -> StudyData:
    tables = {
        "participants": [{**PERSON, **more.get("person", {})}],
        "sessions": [{**SESSION, **more.get("session", {})}],
        "trials": trials,
        "responses": responses,
    }
    return tidy("Study", "1", {}, "", FILES, tables)


def test_the_first_shown_is_a_and_the_second_b() -> None:
    shown = {**trial("1"), "trajectory_a": "left", "trajectory_b": "right"}
    (first,) = tidied([shown], [response("1", "a", {"choice": "a"})]).choices
    assert (first.first, first.second, first.chosen, first.rejected) == ("left", "right", "left", "right")
    (second,) = tidied([shown], [response("1", "b", {"choice": "b"})]).choices
    assert (second.chosen, second.rejected, second.second_chosen) == ("right", "left", True)


@pytest.mark.parametrize(
    ("arms", "choice", "chosen", "rejected", "opponent"),
    [
        ({"own": "a"}, "a", "own", "base", "policy-b"),
        ({"own": "a"}, "b", "base", "own", "policy-b"),
        ({"own": "b"}, "b", "own", "base", "policy-a"),
        ({"own": "b", "other": "a"}, "a", "other", "own", "policy-a"),
        ({"own": "a", "other": "b", "look_alike": True}, "a", "own", "other", "policy-b"),
        ({"own": "a", "neutral": "b"}, "b", "neutral", "own", "policy-b"),
    ],
)
def test_a_comparison_says_which_arm_was_chosen(
    arms: dict, choice: str, chosen: str, rejected: str, opponent: str
) -> None:
    data = tidied([comparison("1", **arms)], [response("1", choice, {"choice": choice})])
    (found,) = data.comparisons
    assert (found.chosen, found.rejected, found.opponent) == (chosen, rejected, opponent)
    assert found.look_alike == ("look_alike" in arms)
    assert data.choices == []


def test_a_guess_is_right_or_wrong_and_nothing_where_there_was_no_comparison() -> None:
    told = [
        {**response(None, None, {"choice": "a", **value}), "kind": "guess"}
        for value in ({"right": True}, {"right": False}, {})
    ]
    assert [one.right for one in tidied([], told).guesses] == [True, False]


def test_a_person_is_what_the_last_appointment_says() -> None:
    plan = [{"key": "1", "kind": "trial", "block": "top_down"}, {"key": "2", "kind": "trial", "block": "immersive"}]
    assigned = {"groups": {"block": "small"}, "blocks": {}}
    (person,) = tidied([], [], session={"plan": [*plan, plan[0]], "assignment": assigned}).people
    assert (person.order, person.groups, person.state) == (("top_down", "immersive"), {"block": "small"}, "completed")
    (gone,) = tidied([], [], person={"excluded": True}).people
    assert gone.excluded == "no reason given"
    (told,) = tidied([], [], person={"excluded": True, "excluded_reason": "looked away"}).people
    assert told.excluded == "looked away"
    assert tidied([], []).people[0].excluded is None


def test_ratings_in_a_block_are_about_its_condition() -> None:
    plan = [
        {
            "key": "block.fun",
            "kind": "questionnaire",
            "stage": "block",
            "questionnaire": "usability",
            "block": "immersive",
        }
    ]
    given = {**response(None, None, {"sus_1": 4}), "step": "block.fun"}
    (rating,) = tidied([], [given], session={"plan": plan}).ratings
    assert (rating.condition, rating.questionnaire, rating.item, rating.value) == ("immersive", "usability", "sus_1", 4)


ABOUT = """
title: {en: About you}
blocks:
  - items:
      - {key: pets, type: choice, text: {en: "Do you live with pets?"},
         options: [{value: yes, label: {en: "Yes"}}, {value: 010, label: {en: "Ten"}}, {value: on, label: {en: "On"}}]}
      - {key: effort, type: scale, points: "5", text: {en: Effort}, low: {en: l}, high: {en: h}, reversed: "false"}
"""


def test_a_frozen_questionnaire_is_read_as_the_study_reads_it() -> None:
    """`yes` was true here and "yes" in the study, so nobody's answer counted; `points: "5"` ended the report."""
    tables = {
        "participants": [PERSON],
        "sessions": [
            {**SESSION, "plan": [{"key": "usability", "kind": "questionnaire", "stage": "q", "questionnaire": "about"}]}
        ],
        "trials": [],
        "responses": [response(None, None, {"pets": "yes", "effort": 5})],
    }
    data = tidy("Study", "1", {}, "", {"questionnaires/about.yaml": ABOUT}, tables)
    pets, effort = data.items
    assert pets.options == {"yes": "Yes", "010": "Ten", "on": "On"}
    assert (effort.points, effort.reversed) == (5, False)
