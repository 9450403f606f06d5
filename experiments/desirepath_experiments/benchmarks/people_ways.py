"""Ways from somebody's answers to a robot that is shown as theirs, as studies have them, each measured by their true
score in fresh scenes.

`each_scene`: a choice per scene, shown to whoever preferred it in blind comparisons. `instant`: a policy conditioned on
the nine objectives, else the library's best, where the posterior is sure of it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.jobs.free_form import FEWEST_ANSWERS
from desirepath.learning.alignment.each_scene import KEPT, choose_each_scene, favourites, scales_of
from desirepath.learning.alignment.gate import surely_better
from desirepath.learning.alignment.own_reward import OwnRewardConfig, train_on_answers
from desirepath.learning.alignment.policy_library import best_of
from desirepath.learning.people.families.base import FamilyMember
from desirepath.learning.policies.choosing import Answers
from desirepath.learning.policies.policy import Policy
from desirepath.learning.preferences.free_posterior import SOMETHING_ELSE
from desirepath.learning.preferences.oracles import ResponseModel
from desirepath.learning.preferences.sureness import Sureness
from desirepath.simulation.fast import rollout
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory, arrived
from desirepath_experiments.benchmarks.own_senses import (
    Driven,
    by_true_score,
    drive_by_senses,
    jerk,
    train_on_true_score,
)
from desirepath_experiments.benchmarks.people_room import (
    Doubles,
    PeopleRoom,
    Rollouts,
    answers_of,
    roll_out,
    true_scores,
)

NEEDED = 5
"""In so many of up to six direct comparisons with the base policy a choice per scene must have been preferred for it to
be shown. Four while its caution was 0.4. With 0.2, which tuning families chose, three of 120 shown robots were truly
worse with four, one with five: so five, set after 60 people of families that nothing was tuned on, confirmed on 60
others."""
BASE = -1
"""Instead of a place in the library: the base policy drives."""
Row = dict[str, Any]


@dataclass(frozen=True)
class WaysConfig:
    """compared: so many scenes in which a choice per scene is compared with the base policy. kept: policies that it has
    to choose from. updates: of one more, trained on the answers (`each_scene_trained`). own_senses: in so many of the
    fresh scenes it also drives by the robot's senses. trained_s: beside it the base policy, trained so long on the
    person's true score of every step."""

    compared: int = 6
    kept: int = KEPT
    updates: int = 0
    own_senses: int = 0
    trained_s: float = 0.0


def go_each_scene(
    person: FamilyMember, answers: Answers, room: PeopleRoom, answering: ResponseModel, config: WaysConfig
) -> dict[str, Row]:
    """Of the choice per scene, of the same with a policy trained on the answers to choose from (`each_scene_trained`),
    of that alone in every scene (`trained_on_answers`), and of the best rollout of the library by the true score
    (`best_in_each`). Shown is what was preferred in comparisons of its own; what they taught (`_learned`) nobody has
    compared."""
    more: list[Policy] = []
    found = _compared("each_scene", person, answers, room, answering, config, more)
    found["best_in_each"] = measure_gain(person, driven(room.rollouts, _true_best(room, person)), room.usual)
    if config.updates:
        training = OwnRewardConfig.of(config.updates, room.seed)
        began = time.process_time()
        more = [train_on_answers(room.robot.base, room.robot.basis, answers.believed[1], training).policy]
        took = time.process_time() - began
        found |= _compared("each_scene_trained", person, answers, room, answering, config, more)
        alone = measure_gain(person, roll_out(more[0], room.scenes), room.usual)
        found["trained_on_answers"] = alone | {"seconds": round(took, 1)}
    return found | _go_by_senses(person, answers, room, config, more)


def _compared(
    name: str,
    person: FamilyMember,
    answers: Answers,
    room: PeopleRoom,
    answering: ResponseModel,
    config: WaysConfig,
    more: list[Policy],
) -> dict[str, Row]:
    """more: further policies to choose from."""
    basis = room.robot.basis
    fresh, some = room.rollouts, room.compared
    if more:
        fresh = fresh.joined(basis, [roll_out(policy, room.scenes) for policy in more])
        some = some.joined(basis, [roll_out(policy, [one.scene for one in some.usual]) for policy in more])
    all_answers, wins = _compare_directly(person, answers, room, some, answering, config)
    told = {"shown": wins >= NEEDED, "asked": len(all_answers) - len(answers), "wins": wins}
    found = {}
    for key, by in ((name, answers), (f"{name}_learned", all_answers)):
        places = choose(room, fresh, by, config.kept)
        of_more = float((places >= len(room.robot.library)).mean())
        found[key] = told | measure_gain(person, driven(fresh, places), room.usual) | {"trained_drives": of_more}
    return found


def go_instant(
    person: FamilyMember, answers: Answers, room: PeopleRoom, answering: ResponseModel, config: WaysConfig
) -> dict[str, Row]:
    """As an alignment job decides (`jobs/aligning.py`, `jobs/free_form.py`)."""
    del answering, config
    robot, (believed, by_steps) = room.robot, answers.believed
    something_else = believed.something_else()
    way, (differences, own) = "nine", room.judge(robot.conditioned.at(believed.objectives.mean_weights()))
    sure = Sureness.of(believed, differences)
    if not surely_better(sure) and something_else >= SOMETHING_ELSE and len(answers) >= FEWEST_ANSWERS:
        way, (differences, own) = "library", room.judge_place(best_of(robot.library, believed, by_steps))
        sure = Sureness.of(believed, differences)
    told = {
        "shown": surely_better(sure),
        "way": way,
        "something_else": something_else,
        "probability_better": sure.better,
        "probability_clearly_better": sure.clearly,
    }
    return {"instant": told | measure_gain(person, own, room.usual)}


WAYS: dict[str, Callable[..., dict[str, Row]]] = {"each_scene": go_each_scene, "instant": go_instant}


def choose(room: PeopleRoom, some: Rollouts, answers: Answers, kept: int) -> NDArray[np.int64]:
    """(scenes,) which of the policies drives in each, as `ChoosingPolicy.places` has it: of the library's the `kept`
    that are expected to gain most on average, and those beyond the library in their place; BASE where the answers
    expect nothing of all."""
    library, count = room.robot.library, len(some.trajectories)
    beyond = np.arange(len(library), count)
    among = np.concatenate([favourites(library, answers, kept - len(beyond)), beyond])
    return _best(some.differences.expected(answers, scales_of(library, answers)), among)


def driven(some: Rollouts, places: NDArray[np.int64]) -> list[Trajectory]:
    """What the policies of these places do, scene by scene."""
    return [
        some.usual[scene] if place == BASE else some.trajectories[place][scene] for scene, place in enumerate(places)
    ]


def measure_gain(person: FamilyMember, own: Sequence[Trajectory], usual: Sequence[Trajectory]) -> Row:
    """Against what the base policy did in the same scenes, where both arrive; gain: in typical differences of a pair.
    -1 where there is no such scene."""
    both = arrived(own) & arrived(usual)
    gained = (true_scores(person, own) - true_scores(person, usual))[both] / person.unit(own[0].scene.setup)
    longer = np.array([first.duration_s - other.duration_s for first, other in zip(own, usual, strict=True)])[both]
    if not len(gained):
        return {"gain": -1.0, "gain_error": 0.0, "changed": 0.0, "preferred": 0.0, "success": 0.0, "longer_s": 0.0}
    return {
        "gain": float(gained.mean()),
        "gain_error": float(gained.std() / np.sqrt(len(gained))),
        "changed": float((gained != 0).mean()),
        "preferred": float(((gained > 0) + 0.5 * (gained == 0)).mean()),
        "success": float(arrived(own).mean()),
        "longer_s": float(longer.mean()),
    }


def _true_best(room: PeopleRoom, person: FamilyMember) -> NDArray[np.int64]:
    """The yardstick: the best rollout of each scene by the true score."""
    some = room.rollouts
    by_policy = true_scores(person, some.everything).reshape(-1, len(some.usual))
    usable = some.differences.usable & room.robot.library.allowed[:, None]
    return _best(np.where(usable, by_policy[1:] - by_policy[0], -np.inf), np.arange(len(usable)))


def _best(gains: Doubles, among: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.where(gains[among].max(0) > 0, among[gains[among].argmax(0)], BASE)


def _compare_directly(
    person: FamilyMember,
    answers: Answers,
    room: PeopleRoom,
    some: Rollouts,
    answering: ResponseModel,
    config: WaysConfig,
) -> tuple[Answers, int]:
    """All answers, and how often the choice per scene was preferred: in scenes of their own, drawn by lot among those
    in which it drives otherwise."""
    places = choose(room, some, answers, config.kept)
    random = np.random.default_rng([room.seed, 67])
    otherwise = random.permutation(np.flatnonzero(places != BASE))[: config.compared]
    own = driven(some, places)
    in_turn = [trajectory for k in otherwise for trajectory in (own[k], some.usual[k])]
    chosen = (
        answers_of(person, in_turn, answering, room.setup, room.seed, 1) if in_turn else np.zeros(0, dtype=np.bool_)
    )
    rows = places[otherwise] * len(some.usual) + otherwise
    after = Answers(
        answers.pairs.joined(some.differences.pairs[rows]),
        np.concatenate([answers.steps, some.differences.steps[rows]]),
        np.concatenate([answers.chosen, chosen]),
        before=answers.before,
    )
    return after, int(chosen.sum())


def _go_by_senses(
    person: FamilyMember, answers: Answers, room: PeopleRoom, config: WaysConfig, more: list[Policy]
) -> dict[str, Row]:
    """The choice by what the robot knows there, again every second (`by_senses`), the same by the true score
    (`by_senses_truly`), what training on that gains (`trained`), and the choice at the start (`at_start`): all in the
    same first scenes."""
    if not config.own_senses:
        return {}
    usual = room.usual[: config.own_senses]
    scenes = [trajectory.scene for trajectory in usual]
    policy = choose_each_scene(answers, kept=config.kept, beside=[one.without_critic() for one in more])
    ways = {
        "at_start": Driven(
            rollout(get_setup(room.setup), policy.rollout_policy, scenes), {"jerk_of_base": jerk(usual)}
        ),
        "by_senses": drive_by_senses(policy, scenes),
        "by_senses_truly": drive_by_senses(policy, scenes, by_true_score(person)),
    }
    trained = train_on_true_score(person, room.robot.base, config.trained_s, room.seed) if config.trained_s else None
    if trained is not None:
        ways["trained"] = Driven(roll_out(trained, scenes), {})
    return {name: measure_gain(person, one.trajectories, usual) | one.told for name, one in ways.items()}
