"""Importance rankings (ch. 8): the robot halts, objects are ranked, and the row tells the whole trial."""

from __future__ import annotations

import csv
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kendalltau
from sqlalchemy import select

from desirepath.explain.shown_explanation import simulate_ranking
from desirepath.grammar.source import ProtocolError
from desirepath.store.dataset.writing import export_study
from desirepath.store.erasure import erase_participant
from desirepath.store.models import Participant, Response, Trial
from desirepath.study.kind import Moment
from desirepath.study.kinds.importance_ranking import KIND
from desirepath.study.protocol.freezing import thaw
from desirepath.study.protocol.planning import example_queries, make_plan
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import StudyError, create_study
from tests.explain.ranking_rooms import small_ranking_set
from tests.study.small_protocol import BLOCK, INFORMATION, small_protocol
from tests.study.walking import GIVEN, Walker

FACTORS = {"outline": ["outline", "plain"], "lidar": ["lidar", "bare"]}
RANKING = {
    "importance_ranking": {
        "each": FACTORS,
        "view": "immersive",
        "trials": 2,
        "practice": 1,
        "before": "instruction.md",
        "questionnaire": "rating",
        "between": "pause.md",
    }
}
CONDITIONS = ("outline-lidar", "outline-bare", "plain-lidar", "plain-bare")


@pytest.fixture(scope="session")
def ranked_rooms(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rankings") / "rankings.npz"
    small_ranking_set().save(path)
    return path


@pytest.fixture
def ranked(tmp_path, database, files, ranked_rooms):
    frozen = small_protocol(tmp_path, [RANKING], query_set=str(ranked_rooms), assignment={"scheme": "all_orders"})
    with database.transaction() as s:
        return create_study(s, files, frozen, name="Ranked", created_by=None)


def halted(walker: Walker) -> list[str]:
    """The rollout was watched; the objects that are to be ranked."""
    key = walker.view.key
    playback = walker.do(machine.start_trial, key, request_id=None, now=walker.now)
    assert playback.label == ""  # one that is shown alone has no letter
    walker.later(3.1)
    walker.do(machine.trajectory_seen, key, "a", playback.playback_id, now=walker.now)
    return walker.view.payload["things"]


def test_objects_are_ranked_once_the_robot_has_halted_and_the_row_has_their_scores(database, files, ranked):
    walker = Walker(database, files, ranked)
    walker.submit("consent", GIVEN)
    shown = walker.view.payload
    assert (shown["role"], shown["number"], shown["of"], shown["outline"], shown["lidar"]) == (
        "practice",
        1,
        1,
        True,
        True,
    )
    with pytest.raises(Refused) as early:
        walker.submit(walker.view.key, {"ranking": shown["things"]})
    assert early.value.code == "too_early"
    things = halted(walker)
    assert sorted(things) == ["box 1", "box 2", "box 3", "pillar 1", "pillar 2"]
    for wrong in (things[:4], [*things, "box 1"], [*things[:4], "box 9"], things[:4] + things[:1]):
        with pytest.raises(Refused, match="each of box 1, box 2"):
            walker.submit(walker.view.key, {"ranking": wrong})
    with pytest.raises(Refused, match="one number per ranked object"):
        walker.submit(walker.view.key, {"ranking": things, "placed_s": [1.0]})
    walker.submit(walker.view.key, {"ranking": things, "undone": 2, "placed_s": [1.25, 2.5, 3.0, 4.0, 6.5]})
    with database.session() as s:
        response, trial = s.execute(
            select(Response, Trial).join(Trial).where(Trial.session_id == walker.session.id)
        ).one()
        assert (response.kind, trial.kind, trial.role, trial.block) == (
            *("importance_ranking", "importance_ranking", "practice"),
            None,
        )
        kept = next(one for one in small_ranking_set().rollouts if one.trajectory.digest() == trial.trajectory_a)
        assert response.value == {
            "ranking": things,
            "hmd": False,
            "headset": None,
            "undone": 2,
            "placed_s": [1.25, 2.5, 3.0, 4.0, 6.5],
            "scores": pytest.approx(kept.at_halt),
            "outline": True,
            "lidar": True,
        }


def test_everybody_ranks_every_rollout_once_over_four_conditions_in_one_of_24_orders(database, files, ranked):
    orders = Counter()
    for _ in range(24):
        plan = Walker(database, files, ranked, simulated=True).session.plan
        steps = [step for step in plan if step["kind"] == "importance_ranking"]
        counted = [step for step in steps if step["role"] == "regular"]
        assert len({step["query"] for step in steps}) == len(steps) == 4 * 2 + 1
        assert Counter(step["block"] for step in counted) == dict.fromkeys(CONDITIONS, 2)
        assert {(step["block"], step["outline"], step["lidar"]) for step in counted} == {
            ("outline-lidar", True, True),
            ("outline-bare", True, False),
            ("plain-lidar", False, True),
            ("plain-bare", False, False),
        }
        orders[tuple(dict.fromkeys(step["block"] for step in counted))] += 1
    assert len(orders) == 24
    assert set(orders.values()) == {1}


def test_rankings_leave_with_the_data_one_row_per_object_and_go_with_who_is_erased(database, files, ranked, tmp_path):
    walk_in_process(database, files, ranked, 2, Character(seed=1))
    export_study(database, files, ranked.id, tmp_path / "out")
    with (tmp_path / "out" / "importance_rankings.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 9 * 5
    first = [row for row in rows if row["response"] == rows[0]["response"]]
    assert [row["rank"] for row in first] == ["1", "2", "3", "4", "5"]
    assert {row["practice"] for row in first} == {"true"}
    assert {(row["condition"], row["outline"], row["lidar"]) for row in rows if row["practice"] == "false"} == {
        ("outline-lidar", "true", "true"),
        ("outline-bare", "true", "false"),
        ("plain-lidar", "false", "true"),
        ("plain-bare", "false", "false"),
    }
    assert all(0 <= float(row["score"]) <= 1 for row in rows)
    with database.session() as s:
        person = s.scalars(select(Participant.id).where(Participant.study_id == ranked.id)).first()
    erase_participant(database, files, person, by="test", data=tmp_path, compact=False)
    export_study(database, files, ranked.id, tmp_path / "later")
    with (tmp_path / "later" / "importance_rankings.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 9 * 5
    assert json.loads((tmp_path / "later" / "study.json").read_text())["format"]


def test_whoever_sees_outlines_ranks_nearer_to_the_scores():
    random = np.random.default_rng(0)

    def agreement(one, scores):
        ranking = simulate_ranking(one.trajectory, one.things, scores, random)
        return kendalltau([-ranking.index(thing) for thing in one.things], one.scores[-1]).statistic

    rollouts = small_ranking_set().rollouts
    told = np.mean([agreement(one, one.at_halt) for one in rollouts for _ in range(60)])
    untold = np.mean([agreement(one, None) for one in rollouts for _ in range(60)])
    assert told > untold + 0.05 > 0.05


def test_simulated_participants_hear_scores_only_where_outlines_tell_them(database, files, ranked):
    walker = Walker(database, files, ranked, simulated=True)
    told = {}
    with database.session() as s:
        moment = Moment(s, s.merge(walker.session, load=False), thaw(ranked), walker.now)
        for step in moment.plan:
            if step.kind == "importance_ranking":
                told[step.outline] = "scores" in KIND.tell_simulated(step, moment, {})
    assert told == {True: True, False: False}


def test_the_set_and_the_protocol_must_fit_each_other(tmp_path, database, files, ranked_rooms, twenty_queries):
    def opened(stages, query_set):
        with database.transaction() as s:
            frozen = small_protocol(tmp_path, stages, query_set=str(query_set))
            create_study(s, files, frozen, name="x", created_by=None)

    with pytest.raises(StudyError, match="holds queries; this protocol needs a ranking set"):
        opened([RANKING], twenty_queries)
    with pytest.raises(StudyError, match="holds rankings; this protocol needs queries"):
        opened([BLOCK], ranked_rooms)
    with pytest.raises(StudyError, match="make two studies"):
        opened([RANKING, BLOCK], ranked_rooms)
    more = {"importance_ranking": {**RANKING["importance_ranking"], "trials": 12}}
    with pytest.raises(StudyError, match="has 8 rollouts and 2 for practice, one session of this protocol ranks 48"):
        opened([more], ranked_rooms)
    wrong = {"importance_ranking": {"view": "top_down", "each": {"outline": ["on", "off"]}}}
    with pytest.raises(ProtocolError, match="must be outline, plain"):
        small_protocol(tmp_path, [wrong], query_set=str(ranked_rooms))
    with pytest.raises(ProtocolError, match="importance_ranking"):
        small_protocol(tmp_path, [INFORMATION], query_set=str(ranked_rooms))


def test_a_preview_plans_one_without_any_set(tmp_path, ranked_rooms):
    protocol = small_protocol(tmp_path, [RANKING], query_set=str(ranked_rooms)).protocol
    steps = make_plan(protocol, 0, example_queries(protocol))
    assert sum(step.kind == "importance_ranking" for step in steps) == 4 * 2 + 1
    assert sum(step.kind == "break" for step in steps) == 3
