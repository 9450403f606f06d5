"""A policy that chooses per scene: what it says it does, alone or among others, is what it drives; files and bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from desirepath.learning.alignment.each_scene import (
    answers_of,
    choose_each_scene,
    leave_each_out,
    people_in_general,
    what_they_weigh,
)
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.choosing import CAUTION, Answers, ChoosingPolicy, PeopleInGeneral
from desirepath.learning.policies.importing import import_policy
from desirepath.learning.policies.policy import PolicyError, network_of, read_policy
from desirepath.learning.policies.shipped import load_policy
from desirepath.npz import to_npz
from desirepath.simulation.acting import ActFunction, EpisodicPolicy
from desirepath.simulation.fast import evaluate, rollout
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import SetupError, get_setup
from tests.answers import prefers_distance

SCENES = draw_scenes("study_room", range(3_500_000_000, 3_500_000_016))


@pytest.fixture(scope="module")
def own() -> ChoosingPolicy:
    return choose_each_scene(answers_of(prefers_distance(12)), kept=4)


def test_it_drives_by_what_it_chose_whichever_scenes_are_beside(own: ChoosingPolicy) -> None:
    setup, places = get_setup("study_room"), own.places(SCENES)
    assert (places > 0).mean() > 0
    assert [int(own.places([scene])[0]) for scene in SCENES[:5]] == places[:5].tolist()
    for scene, place, driven in zip(SCENES, places, rollout(setup, own.rollout_policy, SCENES), strict=True):
        assert own.in_scene(scene) is own.policies[place]
        (alone,) = rollout(setup, own.policies[place].rollout_policy, [scene])
        np.testing.assert_allclose(driven.poses, alone.poses, atol=1e-5)


def test_it_keeps_farther_from_the_person_than_the_base_policy(own: ChoosingPolicy) -> None:
    setup = get_setup("study_room")

    def nearest(policy: ActFunction | EpisodicPolicy) -> float:
        return float(evaluate(policy, setup, SCENES).min_human_distance.mean())

    assert nearest(own.rollout_policy) > nearest(own.policies[0].rollout_policy) + 0.05


def test_who_answered_nothing_is_driven_by_the_base_policy(own: ChoosingPolicy) -> None:
    answers = own.answers
    nothing = Answers(answers.pairs[:0], answers.steps[:0], answers.chosen[:0])
    assert (replace(own, answers=nothing).places(SCENES) == 0).all()


def test_a_file_brings_it_back(own: ChoosingPolicy) -> None:
    mine = replace(own, made_for="P-17")
    again = read_policy(mine.to_bytes())
    assert isinstance(again, ChoosingPolicy)
    assert again.digest() == mine.digest() != own.digest()
    assert again.made_for == "P-17"
    assert (again.places(SCENES[:6]) == own.places(SCENES[:6])).all()
    assert len(mine.to_bytes()) < 4_000_000


def test_what_earlier_people_want_is_read_with_few_own_answers_and_kept_in_the_file(own: ChoosingPolicy) -> None:
    people = [answers_of(prefers_distance(15 + k)) for k in range(10)]
    few = Answers(own.answers.pairs[:6], own.answers.steps[:6], own.answers.chosen[:6])
    by_their_light = replace(few, before=what_they_weigh(people))
    alone, together = (choose_each_scene(answers, kept=4) for answers in (few, by_their_light))
    surely = [policy.answers.believed[1].advantages(few.steps)[0].mean() for policy in (alone, together)]
    assert surely[1] > surely[0]
    again = read_policy(together.to_bytes())
    assert isinstance(again, ChoosingPolicy)
    assert (again.places(SCENES) == together.places(SCENES)).all()
    assert what_they_weigh([]) is None
    header, arrays = together.to_parts()
    arrays["before_steps_mean"] = arrays["before_steps_mean"][:-1]
    with pytest.raises(ValueError, match="before has"):
        ChoosingPolicy.from_parts(header, arrays)


def test_several_people_make_a_policy_of_which_nobody_is_more_than_another(own: ChoosingPolicy) -> None:
    people = people_in_general([answers_of(prefers_distance(12 + k)) for k in range(5)])
    assert leave_each_out(people).in_common
    policy = choose_each_scene(people, kept=4)
    again = read_policy(policy.to_bytes())
    assert isinstance(again, ChoosingPolicy)
    assert (again.places(SCENES[:6]) == policy.places(SCENES[:6])).all()
    assert again.manifest()["answers"] == sum(12 + k for k in range(5))
    header, arrays = policy.to_parts()
    with pytest.raises(ValueError, match="do not fit"):
        ChoosingPolicy.from_parts({**header, "people": [12, 13]}, arrays)


def test_a_file_chooses_as_cautiously_as_when_it_was_made(own: ChoosingPolicy) -> None:
    header, arrays = own.to_parts()
    assert ChoosingPolicy.from_parts(header, arrays).answers.caution == CAUTION
    before = {key: value for key, value in header.items() if key != "caution"}
    assert ChoosingPolicy.from_parts(before, arrays).answers.caution == 0.4
    with pytest.raises(ValueError, match=r"caution = -1\.0: must be from 0 to 10"):
        ChoosingPolicy.from_parts(header | {"caution": -1}, arrays)


def test_thirty_people_of_twenty_answers_make_one_in_general(own: ChoosingPolicy) -> None:
    one = own.answers
    assert isinstance(one, Answers)
    rows = np.arange(20) % len(one)
    twenty = Answers(one.pairs[rows], one.steps[rows], one.chosen[rows])
    many = PeopleInGeneral((twenty,) * 30, np.ones((30, 2)))
    again = read_policy(replace(own, answers=many).to_bytes())
    assert isinstance(again, ChoosingPolicy)
    assert len(again.answers) == 600
    with pytest.raises(PolicyError, match="answers of 101 people: at most 100"):
        replace(own, answers=PeopleInGeneral((twenty,) * 101, np.ones((101, 2))))


@pytest.mark.parametrize("broken", ["steps", "scales"])
def test_what_is_not_finite_is_refused(own: ChoosingPolicy, broken: str) -> None:
    header, arrays = own.to_parts()
    arrays[broken] = np.full_like(arrays[broken], np.nan)
    with pytest.raises((PolicyError, LearningError), match=r"finite|scales"):
        ChoosingPolicy.from_parts(header, arrays)


@pytest.mark.parametrize("part", ["pairs_named", "steps", "basis_mix", "layer_0002"])
def test_what_does_not_fit_together_is_refused_as_it_is_brought(own: ChoosingPolicy, part: str) -> None:
    header, arrays = own.to_parts()
    arrays[part] = arrays[part][:, :-1]
    content = to_npz({"format": own.file_format, **header}, arrays)
    with pytest.raises(ValueError, match=r"shape|mismatch|align|layer"):
        import_policy(content, "own.npz")


def test_it_comes_in_as_it_went_out(own: ChoosingPolicy) -> None:
    assert import_policy(own.to_bytes(), "own.npz").policy.digest() == own.digest()


def test_policies_are_of_one_setup_and_some(own: ChoosingPolicy) -> None:
    with pytest.raises(PolicyError, match="needs the base policy"):
        replace(own, policies=own.policies[:1])
    with pytest.raises(SetupError):
        replace(own, policies=(own.policies[0], load_policy("open_field/base")))


def test_it_is_no_network(own: ChoosingPolicy) -> None:
    with pytest.raises(LearningError, match="whose map and person it knows"):
        network_of(own)
