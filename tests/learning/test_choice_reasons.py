"""What is said of a choice is true of the drives: which way they differ, visibly, and that answers speak for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from desirepath.learning.alignment.each_scene import answers_of, choose_each_scene, people_in_general
from desirepath.learning.measures.steps import reference
from desirepath.learning.people.card import members
from desirepath.learning.people.families.mixture import ObjectiveMember
from desirepath.learning.policies.choice_reasons import reasons_in_scene
from desirepath.learning.policies.choosing import Answers, ChoosingPolicy
from desirepath.learning.policies.reason_codes import Reason
from desirepath.learning.policies.shipped import load_queries
from desirepath.learning.preferences.free_posterior import FreePosterior
from desirepath.learning.preferences.measures import MEASURES, measures
from desirepath.learning.preferences.preferences import Preference
from desirepath.simulation.fast import rollout
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory
from tests.answers import prefers_distance

SCENES = draw_scenes("study_room", range(3_500_000_000, 3_500_000_012))
Told = list[tuple[Trajectory, Trajectory, list[Reason]]]


def answered_by(score: Callable[[Sequence[Trajectory]], NDArray[np.float64]]) -> Answers:
    queries = load_queries("study_room/queries_varied_200").queries[100:115]
    pairs = [(query.trajectory_a, query.trajectory_b) for query in queries]
    better = [pair if np.subtract(*score(list(pair))) > 0 else pair[::-1] for pair in pairs]
    return answers_of([Preference(*pair, "test", "P1") for pair in better])


def who_wants(objective: str) -> ChoosingPolicy:
    return choose_each_scene(answered_by(ObjectiveMember(objective).scores))


def told_of(policy: ChoosingPolicy) -> Told:
    setup = get_setup("study_room")
    own, usual = (rollout(setup, one.rollout_policy, SCENES) for one in (policy, policy.policies[0]))
    return [(a, b, reasons_in_scene(policy, a, b)) for a, b in zip(own, usual, strict=True)]


def nearest_m(driven: Trajectory) -> float:
    person = driven.scene.person.pose
    return float(np.hypot(driven.poses[:, 0] - person.x, driven.poses[:, 1] - person.y).min())


def test_who_wants_distance_is_told_of_more_distance_where_there_is_visibly_more() -> None:
    policy = who_wants("farther")
    told = told_of(policy)
    usually = [reasons == [Reason("as_usual")] for _, _, reasons in told]
    assert usually == (policy.places(SCENES) == 0).tolist()
    said = [(own, usual, one) for own, usual, reasons in told for one in reasons if one.did != "as_usual"]
    assert len(said) >= 4
    for own, usual, reason in said:
        assert reason.did == "farther"
        assert (reason.own, reason.usual) == pytest.approx((nearest_m(own), nearest_m(usual)), abs=1e-4)
        assert nearest_m(own) >= nearest_m(usual) + 0.2


@pytest.mark.parametrize(("objective", "did"), [("slower_near_person", "slower_near"), ("smoother", "straighter")])
def test_every_reason_is_what_that_person_wants(objective: str, did: str) -> None:
    said = [one for _, _, reasons in told_of(who_wants(objective)) for one in reasons if one.did != "as_usual"]
    assert said
    for reason in said:
        assert reason.did == did
        assert reason.own is not None
        assert reason.usual is not None
        assert reason.own < reason.usual


def test_who_is_not_described_by_the_nine_is_told_of_what_goes_with_their_own_score() -> None:
    person = members("thresholds", 1, "study_room", 3)["thresholds:3"]
    policy = choose_each_scene(answered_by(person.scores))
    free, _ = policy.answers.believed
    assert isinstance(free, FreePosterior)
    assert free.something_else() > 0.5
    said = {one.did for _, _, reasons in told_of(policy) for one in reasons if one.did != "as_usual"}
    driven = list(reference("study_room").trajectories)
    scores, speed = person.scores(driven), measures(driven)[:, MEASURES.index("speed_near_person_m_s")]
    goes_with = np.corrcoef(scores[0::2] - scores[1::2], speed[0::2] - speed[1::2])[0, 1]
    assert goes_with < -0.3
    assert said == {"slower_near"}


def test_where_several_people_chose_nothing_is_said_of_anybodys_answers() -> None:
    policy = choose_each_scene(people_in_general([answers_of(prefers_distance(12 + k)) for k in range(5)]), kept=4)
    assert [reasons for _, _, reasons in told_of(policy)] == [[]] * len(SCENES)
