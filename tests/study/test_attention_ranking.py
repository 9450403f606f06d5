"""Rankings among pedestrians: what a policy attends to is shown or hidden, and people are ranked by it."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from sqlalchemy import select

from desirepath.explain.ranking_sets import RankingSet
from desirepath.learning.errors import LearningError
from desirepath.learning.pedestrians.crowd_networks import Actor, actor_to_arrays
from desirepath.learning.policies.attention import AttentionPolicy
from desirepath.learning.shipping.storing import Request
from desirepath.report.study_report import write_study_report
from desirepath.report.tidy_tables import read_folder
from desirepath.store.dataset.writing import export_study
from desirepath.store.models import Response, Session
from desirepath.study.kind import Moment
from desirepath.study.kinds.importance_ranking import KIND
from desirepath.study.protocol.freezing import freeze_text, thaw
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import StudyError, create_study
from desirepath_experiments.shipping.ranking_sets import find_attended, ship_ranking_set
from tests.explain.ranking_rooms import small_ranking_set
from tests.study.small_protocol import small_protocol
from tests.study.walking import Walker

PROTOCOL = Path(__file__).resolve().parents[2] / "study_protocols" / "crowd_explanation_study.yaml"
FIVE = ("person", "pedestrian 1", "pedestrian 2", "pedestrian 3", "pedestrian 4")


@cache
def small_attended_set() -> RankingSet:
    """Of an untrained policy that looks hard somewhere: eight rollouts and two for practice."""
    torch.manual_seed(3)
    actor = Actor("ours")
    for stream in (actor.read.spatial, actor.read.temporal):
        stream.score[-1].weight.data *= 10  # untrained, it would look everywhere alike
    policy = AttentionPolicy("crowd_corridor", actor_to_arrays(actor))
    return find_attended(policy, "untrained", 8, 2)[0]


@pytest.fixture(scope="session")
def attended_people(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("attended") / "attended.npz"
    small_attended_set().save(path)
    return path


def protocol_with(path: Path, trials: int = 2) -> str:
    text = PROTOCOL.read_text().replace("crowd_corridor/scenarios_24", str(path))
    assert "trials: 6" in text
    return text.replace("trials: 6", f"trials: {trials}")


@pytest.fixture
def attended_study(database, files, attended_people):
    with database.transaction() as s:
        return create_study(s, files, freeze_text(protocol_with(attended_people)), name="Attended", created_by=None)


def test_a_rollout_among_people_has_the_attention_of_every_moment_and_comes_back_from_its_file() -> None:
    made = small_attended_set()
    again = RankingSet.from_bytes(made.to_bytes())
    assert again.to_bytes() == made.to_bytes()
    for kept, read in zip(made.rollouts, again.rollouts, strict=True):
        assert kept.things == read.things == FIVE
        assert kept.trajectory.duration_s == pytest.approx(3.0)
        assert kept.scores.shape == (16, 5)
        assert kept.attention is not None
        assert read.attention is not None
        for part, whole in zip(read.attention, kept.attention, strict=True):
            assert part.shape == (16, 30)
            np.testing.assert_allclose(part, whole, atol=1e-3)
            np.testing.assert_allclose(whole.sum(axis=1), 1.0, atol=1e-3)


def test_who_is_looked_at_hardest_by_both_streams_gets_the_whole_score() -> None:
    """The weight is laid on one sector and one ray that really point at somebody; the score is theirs alone."""
    from desirepath.learning.pedestrians.attended import attention_to_people
    from desirepath.learning.pedestrians.crowd_evaluation import CrowdRollout

    one = next(one for one in small_attended_set().rollouts if one.scores[-1].max() > 0)
    trajectory = one.trajectory
    x, y, yaw = (float(value) for value in trajectory.poses[0])
    people = trajectory.scene.people_at([0.0])[:, 0]
    away = np.hypot(*(people - (x, y)).T)
    nearest = int(away.argmin())
    bearing = (np.arctan2(people[nearest, 1] - y, people[nearest, 0] - x) - yaw) % (2 * np.pi)
    # a made scan: one point per sector of 2 degrees, on the nearest person's near side where they are, far elsewhere
    angles = (np.arange(180) + 0.5) * 2 * np.pi / 180
    off = np.abs((angles - bearing + np.pi) % (2 * np.pi) - np.pi)
    ranges = np.where(off < 0.1, away[nearest] - 0.1, 3.5)
    points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1) / 3.5
    states = np.zeros((1, 490), np.float32)
    states[0, :360] = points.ravel()
    made = CrowdRollout(trajectory.scene, trajectory.outcome, trajectory.poses[:1], states, trajectory.actions[:0])
    sector, ray = int(bearing / (2 * np.pi) * 30), round(bearing / (2 * np.pi) * 30) % 30
    spatial, temporal = np.full((1, 30), 1e-3), np.full((1, 30), 1e-3)
    spatial[0, sector], temporal[0, ray] = 1.0, 1.0
    scores = attention_to_people(made, spatial, temporal)[0]
    assert scores.argmax() == nearest
    assert scores[nearest] == pytest.approx(1.0)
    assert np.delete(scores, nearest).max() < 0.01


def shown_in(walker: Walker, database, study) -> dict[tuple[bool, bool], tuple[bool, bool, bool, bool]]:
    """(attention, lidar) of a step -> what is shown: attention, outlines, lidar, and whether a bot hears of scores."""
    found = {}
    with database.session() as s:
        moment = Moment(s, s.merge(walker.session, load=False), thaw(study), walker.now)
        for step in moment.plan:
            if step.kind == "importance_ranking":
                shown = KIND.explains(step, moment)
                knows = "scores" in KIND.tell_simulated(step, moment, {})
                found[step.attention, step.lidar] = (shown.attention is not None, shown.outlines, shown.lidar, knows)
    return found


def test_attention_is_shown_in_half_of_the_conditions_and_never_outlines(database, files, attended_study) -> None:
    walker = Walker(database, files, attended_study, simulated=True)
    assert shown_in(walker, database, attended_study) == {
        (attention, lidar): (attention, False, lidar, attention)
        for attention in (True, False)
        for lidar in (True, False)
    }


def test_a_simulated_participant_ranks_people_and_the_report_tests_attention_and_lidar(
    database, files, attended_study, tmp_path
) -> None:
    walk_in_process(database, files, attended_study, 3, Character(seed=1))
    with database.session() as s:
        assert [one.state for one in s.scalars(select(Session))] == ["completed"] * 3
        values: Sequence[dict] = [one.value for one in s.scalars(select(Response)) if one.kind == "importance_ranking"]
    assert all(sorted(value["ranking"]) == sorted(FIVE) and value["outline"] is False for value in values)
    assert Counter(value["attention"] for value in values) == {True: 3 * 6, False: 3 * 4}  # practice shows everything
    export_study(database, files, attended_study.id, tmp_path / "out")
    with (tmp_path / "out" / "importance_rankings.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {(row["condition"], row["attention"], row["lidar"]) for row in rows if row["practice"] == "false"} == {
        ("attention-lidar", "true", "true"),
        ("attention-bare", "true", "false"),
        ("hidden-lidar", "false", "true"),
        ("hidden-bare", "false", "false"),
    }
    data, load = read_folder(tmp_path / "out")
    write_study_report(data, load, tmp_path / "report", who="simulated", command="desirepath studies report")
    said = (tmp_path / "report" / "report.html").read_text()
    assert "attention" in said
    assert "attention × lidar" in said or "attention and lidar" in said


def test_what_a_set_does_not_have_can_be_no_condition(tmp_path, database, files, attended_people) -> None:
    things = tmp_path / "things.npz"
    small_ranking_set().save(things)

    def opened(factors, path):
        stage = {"importance_ranking": {"each": factors, "view": "top_down", "trials": 1, "practice": 1}}
        with database.transaction() as s:
            create_study(s, files, small_protocol(tmp_path, [stage], query_set=str(path)), name="x", created_by=None)

    with pytest.raises(StudyError, match=r"needs a policy's attention.*use a set such as crowd_corridor/scenarios_24"):
        opened({"attention": ["attention", "hidden"]}, things)
    with pytest.raises(StudyError, match="ranks people; use the factor attention"):
        opened({"outline": ["outline", "plain"]}, attended_people)


def test_without_the_policy_the_command_says_which_one_makes_it(tmp_path) -> None:
    with pytest.raises(LearningError, match=r"is missing: make it first with `desirepath ship attent"):
        ship_ranking_set(Request("crowd_corridor", folder=tmp_path))
