"""Tables as exported become tidy rows: what is no choice and no rating does not become one."""

from __future__ import annotations

import json
from dataclasses import asdict
from datetime import UTC, datetime

import yaml

from backend.analysis.scales import SCALES
from backend.report.tidy_tables import tidy

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
    "plan": [{"key": "usability", "kind": "questionnaire", "questionnaire": "usability"}],
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
