"""What a session's answers have taught so far, answer by answer, and how the robot would behave by it now.

For experimenters who watch. What a participant is shown is made by jobs and `alignment_jobs.py`.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.models import Session
from desirepath.study.personalising import next_query
from desirepath.study.personalising.clicking import PositionBias, find_letters, position_bias
from desirepath.study.protocol_rows import row_of

if TYPE_CHECKING:
    from desirepath.simulation.trajectory import Trajectory

SCENES = 3
SCENES_SEED = 0  # of the figures' scenes: the same for everybody, so that participants can be compared
SOON = 20  # ours: so many answers are taken in within a tenth of a second
KEPT = 64  # pages ask every few seconds, answers come every half minute


@dataclass(frozen=True)
class Learnt:
    """shares: after each answer, the expected share of each objective in what is preferred, by name. weights:
    what the conditioned policy is conditioned on now, those above zero. odds: how many times more probable the answers
    are by what was predicted of each from those before it than by a coin; says_something: whether that is enough to say
    what this person prefers. sides: how often the same letter was chosen. pairs: trajectories of base and conditioned
    policy in the same scenes; empty where no conditioned policy comes with the setup."""

    shares: tuple[dict[str, float], ...]
    weights: dict[str, float]
    entropy_bits: float
    odds: float
    says_something: bool
    sides: PositionBias
    pairs: tuple[tuple[Trajectory, Trajectory], ...]


class Known(OrderedDict[tuple[str, next_query.Answers], Learnt]):
    """What this process knows already, by session and answers; the one that was asked for last is the last."""


def takes_long(s: DatabaseSession, files: ArtefactStore, session: Session) -> bool:
    """Whether `find_learnt` would keep a page waiting: many answers, and nobody has asked since the last of them."""
    answers = next_query.answers_of(s, session)
    return len(answers) > SOON and (session.id, answers) not in files.derive(Known)


def find_learnt(s: DatabaseSession, files: ArtefactStore, session: Session) -> Learnt:
    """What is learned from the session's regular answers so far; practice and probes teach nothing."""
    memory, known_so_far = next_query.recall(files), files.derive(Known)
    measured = memory.measure_queries(s, files, row_of(s, session))
    answers = next_query.answers_of(s, session)
    key = (session.id, answers)
    if key in known_so_far:
        known_so_far.move_to_end(key)
        return known_so_far[key]
    from desirepath.learning.preferences.objectives import SIZE, names_of
    from desirepath.learning.preferences.predictive_power import better_than_chance, odds_against_chance

    after = [memory.posterior(measured, answers[:n]) for n in range(len(answers) + 1)]
    places, likelihoods = measured.index(), []
    for before, given in zip(after, answers, strict=False):
        if given.chosen is None:  # nothing that could have been otherwise by a coin
            continue
        row = places[given.query]
        probable = float(before.predict(measured.differences[[row]])[0])
        likelihoods.append(probable if given.chosen == measured.queries[row].trajectory_a else 1 - probable)
    odds = odds_against_chance(np.array(likelihoods))
    sides = position_bias(find_letters(s, session))
    weights = after[-1].mean_weights() if answers else np.zeros(SIZE, dtype=np.float32)
    known_so_far[key] = learnt = Learnt(
        shares=tuple(posterior.importance() for posterior in after[1:]),
        weights={name: float(weight) for name, weight in zip(names_of(measured.setup), weights, strict=True) if weight},
        entropy_bits=after[-1].entropy_bits(),
        odds=odds,
        says_something=better_than_chance(odds) and not sides.is_found,
        sides=sides,
        pairs=_trajectories(measured.setup, weights),
    )
    while len(known_so_far) > KEPT:
        known_so_far.popitem(last=False)
    return learnt


def _trajectories(setup: str, weights: NDArray[np.float32]) -> tuple[tuple[Trajectory, Trajectory], ...]:
    from desirepath.learning.policies.shipped import load_conditioned, load_policy
    from desirepath.learning.scene_sets import Purpose, scene_set
    from desirepath.learning.shipped_files import shipped_names
    from desirepath.simulation.fast import rollout
    from desirepath.simulation.setups import get_setup

    if f"{setup}/conditioned" not in shipped_names():
        return ()
    scenes = scene_set(setup, SCENES, purpose=Purpose.FIGURE, seed=SCENES_SEED)
    policies = (load_policy(f"{setup}/base"), load_conditioned(f"{setup}/conditioned").at(weights))
    rollouts = [rollout(get_setup(setup), policy.rollout_policy, scenes) for policy in policies]
    return tuple(zip(*rollouts, strict=True))
