"""Drawn paths that count in the posterior of the session, as choices among what the robot could have done there."""

from __future__ import annotations

import numpy as np
import pytest
from sqlalchemy import select

from desirepath.grammar.source import ProtocolError
from desirepath.learning.preferences.evidence.demonstrated import Demonstrated
from desirepath.learning.preferences.evidence.evidence import Habits
from desirepath.learning.preferences.from_paths import ALTERNATIVES
from desirepath.store.models import Session, StrokeRow
from desirepath.study.personalising import next_query
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import StudyError, create_study
from tests.study.small_protocol import BLOCK, small_protocol

PATHS = {"demonstrations": {"environment": "study_room", "pairs": 4, "per_pair": 1, "at_once": True}}
CHOSEN = {"block": {"view": "top_down", "trials": [{"queries": {"count": 2, "choose": "information"}}]}}


def test_a_path_is_a_choice_among_the_others_and_sometimes_made_without_looking():
    worth = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [-30.0, 0.0, 0.0]])
    habits = Habits(np.array([0.0, 0.0, 0.3]), np.zeros((3, 2)))
    said = np.exp(Demonstrated(np.zeros((3, 1, 7))).log_likelihood(worth, habits))
    assert said == pytest.approx([np.e / (np.e + 2), 1 / 3, 0.1])


def test_paths_come_before_the_pairs_that_are_chosen_after_them(database, files, tmp_path, twenty_queries):
    frozen = small_protocol(tmp_path, [PATHS, CHOSEN], query_set=str(twenty_queries))
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Paths", created_by=None)
    assert walk_in_process(database, files, study, 1, Character("person-on-left"))["completed"] == 1
    with database.transaction() as s:
        session = s.scalars(select(Session)).one()
        answers = next_query.answers_of(s, session)
        assert [type(one).__name__ for one in answers] == ["GivenPath"] * 4 + ["Given"] * 2
        places = [step["pair"] for step in session.plan if step["kind"] == "demonstration"]
        assert [one.pair for one in answers[:4]] == places
        posterior = next_query.posterior_of(s, files, session)
        assert [len(one.measured) for one in posterior.evidence] == [1 + ALTERNATIVES] * 4
        assert posterior.dominant() == "person_on_left"
        s.scalars(select(StrokeRow).where(StrokeRow.pair == places[0])).one().left_out_at = session.created_at
        s.flush()
        assert len(next_query.answers_of(s, session)) == 5


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"environment": "corridor"}, "paths count at once in study_room alone"),
        ({"at_once": False}, "paths count at once in study_room alone"),
        ({"person": "walks"}, "must be still"),
    ],
)
def test_paths_count_at_once_only_where_it_is_known_what_else_could_have_been_done(tmp_path, changed, message):
    with pytest.raises(ProtocolError, match=message):
        small_protocol(tmp_path, [{"demonstrations": PATHS["demonstrations"] | changed}, BLOCK])


def test_no_controller_learns_from_them(tmp_path):
    train = {"train": {"job": "demonstrations"}}
    with pytest.raises(ProtocolError, match="which no controller learns from"):
        small_protocol(tmp_path, [PATHS, train])


def test_queries_beside_them_are_of_the_same_room(database, files, tmp_path):
    frozen = small_protocol(tmp_path, [PATHS, BLOCK], query_set="open_field/queries_varied_200")
    with database.transaction() as s, pytest.raises(StudyError, match="choose queries of study_room"):
        create_study(s, files, frozen, name="Elsewhere", created_by=None)
