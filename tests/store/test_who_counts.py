"""Who counts is one set of rules: for rows that are loaded and in queries alike, and the same in every room."""

from __future__ import annotations

from itertools import product

import pytest
from sqlalchemy import select

from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import analyse
from desirepath.report.tidy_tables import read_study
from desirepath.store.dataset.writing import answers_of
from desirepath.store.models import Participant, Session, Study, utc_now
from desirepath.store.sides import SIDES, chosen_and_rejected, is_side, other_side, shown_on
from desirepath.store.snapshots import load_snapshot, take_snapshot
from desirepath.store.who_counts import (
    GROUPS,
    group_of,
    in_group,
    is_asked_for,
    learned_from,
    left_out,
    left_out_of_study,
    lets_us_learn,
    not_left_out,
    participants_condition,
    reason_not_to_learn,
    same_kind,
)
from tests.store.small_study import SmallStudy

MARKS = ("simulated", "pilot", "excluded", "withdrawn", "refused")


@pytest.fixture
def everybody(study: SmallStudy) -> SmallStudy:
    """One participant for each way of being marked: 32 of them."""
    with study.database.transaction() as s:
        for number, marks in enumerate(product((False, True), repeat=len(MARKS))):
            simulated, pilot, excluded, withdrawn, refused = marks
            s.add(
                Participant(
                    study_id=study.id,
                    code=f"P{number}",
                    simulated=simulated,
                    pilot=pilot,
                    excluded_at=utc_now() if excluded else None,
                    withdrawn_at=utc_now() if withdrawn else None,
                    consents={"training": not refused},
                )
            )
    return study


def codes(study: SmallStudy, condition: object) -> set[str]:
    with study.database.session() as s:
        return set(s.scalars(select(Participant.code).where(condition)))


def test_rows_and_queries_agree_about_everybody(everybody: SmallStudy):
    with everybody.database.session() as s:
        people = list(s.scalars(select(Participant)))
    assert len(people) == 32
    for group in GROUPS:
        there = {p.code for p in people if group_of(simulated=p.simulated, pilot=p.pilot) == group}
        assert codes(everybody, in_group(group)) == there
        assert there
    for whose in ("people", "simulated", "all"):
        assert codes(everybody, participants_condition(whose)) == {
            p.code for p in people if is_asked_for(whose, simulated=p.simulated)
        }
    assert codes(everybody, not_left_out()) == {p.code for p in people if left_out_of_study(p) is None}
    for simulated, pilot in product((False, True), repeat=2):
        assert len(codes(everybody, same_kind(simulated=simulated, pilot=pilot))) == 8
    for whose in ("people", "simulated", "all", "session"):
        may = {p.code for p in people if reason_not_to_learn(p, whose) is None}
        willing = {p.code for p in people if lets_us_learn(p)}
        assert codes(everybody, learned_from(whose)) & willing == may


def test_a_reason_is_given_in_the_order_in_which_it_matters():
    assert left_out(excluded=True, withdrawn=True) == "excluded"
    assert left_out(excluded=False, withdrawn=True) == "withdrawn"
    assert left_out(excluded=False, withdrawn=False) is None


def test_every_room_counts_the_same_people(study: SmallStudy):
    """What a snapshot learns from, a report analyses and a data set marks."""
    kept = {"P1", "P2"}
    for number, code in enumerate(("P1", "P2", "gone", "out", "bot")):
        person, session = study.participant(code, simulated=code == "bot", drives=100 * number)
        with study.database.transaction() as s:
            row = s.get_one(Participant, person)
            s.get_one(Session, session).state = "completed"
            row.withdrawn_at = utc_now() if code == "gone" else None
            row.excluded_at = utc_now() if code == "out" else None
    study.participant("pilot", pilot=True, drives=900)
    with study.database.transaction() as s:
        learned = load_snapshot(s, study.files, take_snapshot(s, study.files, study_id=study.id).id)
        row = s.get_one(Study, study.id)
        analysed = analyse(*read_study(s, study.files, row), "people", AnalysisPlan()).analysed
        tables = answers_of(s, row)
    assert {answer.participant for answer in learned.answers} == set(analysed) == kept
    marked = {
        p["participant"] for p in tables["participants"] if not (p["simulated"] or p["excluded"] or p["withdrawn"])
    }
    assert marked == kept
    practice = {row["trial"] for row in tables["responses"] if row["practice"]}
    assert not practice & {answer.trial for answer in learned.answers}


def test_a_side_names_its_trajectory():
    assert [shown_on(side, "first", "second") for side in SIDES] == ["first", "second"]
    assert chosen_and_rejected("b", "first", "second") == ("second", "first")
    assert [other_side(side) for side in SIDES] == ["b", "a"]
    assert [is_side(one) for one in ("a", "b", "c", None)] == [True, True, False, False]
