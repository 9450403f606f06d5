"""Pairs of which one may say that they do not differ, or how clearly: stored, exported, believed, learned from."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from sqlalchemy import select

from desirepath.jobs import answers as of_jobs
from desirepath.jobs.answers import preferences_of
from desirepath.jobs.context import JobContext
from desirepath.learning.preferences.objectives import NAMES
from desirepath.learning.preferences.preferences import usable
from desirepath.learning.rewards.held_out import accuracy
from desirepath.learning.rewards.linear import fit_linear
from desirepath.learning.rewards.weights import fit_weights
from desirepath.report.choice_text import agreement_section
from desirepath.report.findings import analyse
from desirepath.report.tidy_tables import read_study
from desirepath.store.dataset.writing import export_study
from desirepath.store.models import Response, Session
from desirepath.store.sides import is_answer_to_pair
from desirepath.store.snapshots import Snapshot, load_snapshot, take_snapshot
from desirepath.study.personalising import next_query
from desirepath.study.personalising.learnt import find_learnt
from desirepath.study.refusals import Refused
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from tests.study.small_protocol import small_protocol

BOTH = {"no_difference": True, "degree": "strength"}


def block(answers: dict, *, count: int = 4, **queries: object) -> dict:
    asked = {"count": count, **queries}
    return {"block": {"view": "top_down", "answers": answers, "trials": [{"queries": asked}]}}


@pytest.mark.parametrize(
    ("answers", "said", "stored"),
    [
        (BOTH, {"choice": "a", "degree": "clear"}, {"degree_of": "strength", "possible": 5}),
        (BOTH, {"degree": "no_difference"}, {"possible": 5}),
        ({"no_difference": True}, {"choice": "b"}, {"possible": 3}),
        ({"degree": "confidence"}, {"choice": "b", "degree": "slight"}, {"degree_of": "confidence", "possible": 4}),
        ({}, {"choice": "a"}, {}),
    ],
)
def test_what_is_asked_is_what_may_be_answered_and_is_stored(walk, answers, said, stored):
    walker = walk(block(answers))
    walker.watch("block.01")
    walker.submit("block.01", said)
    with walker.database.session() as s:
        value = s.scalars(select(Response.value).where(Response.step_key == "block.01")).one()
    assert value == said | stored
    assert is_answer_to_pair(value)


@pytest.mark.parametrize(
    "value",
    [
        {"choice": "c"},
        {"choice": "a", "degree": "clear"},
        {"choice": "a", "degree": "very", "possible": 5},
        {"degree": "no_difference", "possible": 4},
        {"choice": "a", "possible": 5},
        {"choice": "a", "possible": "5"},
        {"choice": "a", "possible": 9},
        {"timed_out": True},
    ],
)
def test_what_was_imported_and_could_not_be_answered_teaches_nothing(value):
    assert not is_answer_to_pair(value)


@pytest.mark.parametrize(
    ("answers", "said", "field"),
    [
        ({}, {"degree": "no_difference"}, "value.choice"),
        ({"degree": "strength"}, {"degree": "no_difference"}, "value.choice"),
        (BOTH, {"choice": "a"}, "value.degree"),
        (BOTH, {"choice": "a", "degree": "no"}, "value.degree"),
    ],
)
def test_nothing_else_is_an_answer(walk, answers, said, field):
    walker = walk(block(answers))
    walker.watch("block.01")
    with pytest.raises(Refused) as refused:
        walker.submit("block.01", said)
    assert refused.value.field == field


def test_simulated_people_answer_and_one_posterior_data_set_and_models_have_it(
    database, files, tmp_path, twenty_queries, monkeypatch
):
    frozen = small_protocol(tmp_path, [block(BOTH, count=12, choose="information")], query_set=str(twenty_queries))
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Graded", created_by=None)
    said = walk_in_process(database, files, study, 3, Character(oracle="shortest"))
    assert (said["completed"], said["participants"]) == (3, 3)
    with database.session() as s:
        values = [r.value for r in s.scalars(select(Response).where(Response.kind == "preference"))]
        assert {value["degree"] for value in values} == {"no_difference", "slight", "clear"}
        for session in s.scalars(select(Session).where(Session.study_id == study.id)):
            posterior = next_query.posterior_of(s, files, session)
            assert len(posterior.evidence) == 12
            assert not len(posterior.chosen)
            assert posterior.importance()["shorter"] > 0.5
            assert find_learnt(s, files, session).says_something
        data, load = read_study(s, files, study)
    chosen = [value for value in values if "choice" in value]
    assert len(data.choices) == len(chosen)
    found = analyse(data, load, "simulated")
    (of,) = found.degrees.values()
    assert of.answers == len(values)
    ties = [value["degree"] == "no_difference" for value in values]
    assert of.no_difference.mean == pytest.approx(np.mean(ties))  # of equally many answers each
    assert "no difference" in str(agreement_section(found).tables)
    export_study(database, files, study.id, tmp_path / "out")
    with (tmp_path / "out" / "responses.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["kind"] == "preference"]
    assert [json.loads(row["value"]) for row in rows] == values
    assert {row["choice"] for row in rows} == {"a", "b", ""}
    assert "degree_of" in (tmp_path / "out" / "data-dictionary.md").read_text()

    with database.transaction() as s:
        artefact = take_snapshot(s, files, study_id=study.id, whose="simulated")
        snapshot = load_snapshot(s, files, artefact.id)
    assert Snapshot.from_bytes(snapshot.to_bytes()) == snapshot
    assert artefact.card["ties"] == len(values) - len(chosen) == len(snapshot.ties)
    context = JobContext(None, database, files, None, None)
    preferences = [one for own in preferences_of(context, snapshot).values() for one in own]
    assert len(preferences) == len(values)
    assert len(usable(preferences)[1]) == len(chosen), "who reads pairs alone reads no ties"
    assert accuracy(fit_linear(preferences), preferences) > 0.8
    shares = fit_weights(preferences).shares
    assert NAMES[int(np.argmax(shares))] == "shorter"

    tied = snapshot.ties[0].participant
    undecided = replace(snapshot, answers=tuple(one for one in snapshot.answers if one.participant != tied))
    monkeypatch.setattr(of_jobs, "snapshot_of", lambda *_: (artefact, undecided))
    earlier = of_jobs.earlier_people(context, "it", snapshot.setup)
    assert len(earlier) == 2, "who only saw no difference tells nothing of what people weigh"
