"""What jobs learn from: the answers of a snapshot, the reward model fitted to them, and its artefact.

How a reward model is fitted is `desirepath.learning.rewards`'; which job wants which model is the job's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any, cast

import numpy as np
import structlog

from desirepath.jobs.context import JobContext
from desirepath.jobs.kept_artefacts import find_artefact, keep
from desirepath.jobs.params import Params
from desirepath.learning.errors import TooFewAnswers
from desirepath.learning.measures.pairs import PairDifferences
from desirepath.learning.preferences.evidence.graded_pair import Degree, Possible
from desirepath.learning.preferences.free_posterior import FreeConfig, FreePosterior
from desirepath.learning.preferences.population_prior import EarlierPerson, WeightPrior
from desirepath.learning.preferences.posterior import PosteriorConfig
from desirepath.learning.preferences.predictive_check import PredictiveCheck, check_answers
from desirepath.learning.preferences.preferences import Preference, usable
from desirepath.learning.preferences.spans import equally_long, marked_parts
from desirepath.learning.rewards.held_out import CHANCE, Prediction, majority_share, predictions
from desirepath.learning.rewards.kinds import FITTINGS
from desirepath.learning.rewards.reward_model import Fit, FitSettings, Reduction, RewardModel
from desirepath.simulation.trajectory import Trajectory, require_poses
from desirepath.store.artefacts import ArtefactError, load_trajectory
from desirepath.store.models import Artefact
from desirepath.store.snapshots import (
    Answer,
    MarkedMoment,
    Snapshot,
    implied_choices,
    independent_choices,
    load_snapshot,
)

log = structlog.get_logger("desirepath.jobs")


def snapshot_of(context: JobContext, reference: str) -> tuple[Artefact, Snapshot]:
    """A snapshot and its artefact. Raises ArtefactError as `find_artefact` does."""
    with context.database.session() as s:
        artefact = find_artefact(s, reference, "snapshot")
        snapshot = load_snapshot(s, context.files, artefact.id)
    return artefact, snapshot


def preferences_of(
    context: JobContext, snapshot: Snapshot, *, independent: bool = False
) -> dict[str, list[Preference]]:
    """The answers by participant, also that there is no difference. Probes ask the same again: they measure, they do
    not teach.

    independent: of the choices that ratings and marks imply only such as share none of them, for what counts how sure
    it may be.
    """
    loaded: dict[str, Trajectory] = {}

    def trajectory(trajectory_id: str) -> Trajectory:
        if trajectory_id not in loaded:
            loaded[trajectory_id] = load_trajectory(context.files, trajectory_id)
            require_poses([loaded[trajectory_id]])
        return loaded[trajectory_id]

    def preference(answer: Answer) -> Preference:
        shown, degree = (trajectory(answer.chosen), trajectory(answer.rejected)), cast("Degree | None", answer.degree)
        return Preference(*shown, answer.source, answer.participant, degree, cast("Possible", answer.possible))

    by_participant: dict[str, list[Preference]] = {}
    for answer in snapshot.training_answers():
        by_participant.setdefault(answer.participant, []).append(preference(answer))
    for tie in snapshot.ties:
        shown, possible = (trajectory(tie.trajectory_a), trajectory(tie.trajectory_b)), cast("Possible", tie.possible)
        alike = Preference(*shown, tie.source, tie.participant, "no_difference", possible)
        by_participant.setdefault(tie.participant, []).append(alike)
    for better, worse in (independent_choices if independent else implied_choices)(snapshot.ratings):
        pair = Preference(
            trajectory(better.trajectory), trajectory(worse.trajectory), better.source, better.participant
        )
        by_participant.setdefault(better.participant, []).append(pair)
    for mark, marked, other in _marked_parts(snapshot, trajectory, independent=independent):
        shown = (marked, other) if mark.better else (other, marked)
        by_participant.setdefault(mark.participant, []).append(Preference(*shown, mark.source, mark.participant))
    return by_participant


def _marked_parts(
    snapshot: Snapshot, load: Callable[[str], Trajectory], *, independent: bool
) -> Iterator[tuple[MarkedMoment, Trajectory, Trajectory]]:
    """Each marked part of a trajectory beside each part of it that was not marked so; independent: beside one that no
    other is compared with."""
    alike: dict[tuple[str, bool], list[MarkedMoment]] = {}
    for mark in snapshot.marks:
        alike.setdefault((mark.response, mark.better), []).append(mark)
    for of_one in alike.values():
        marked, others = marked_parts(load(of_one[0].trajectory), [mark.at_s for mark in of_one])
        pairs = zip(marked, others, strict=False) if independent else product(marked, others)
        yield from ((of_one[0], *equally_long(*pair)) for pair in pairs)


def fit_of(
    model: str, reduction: Reduction, seed: int, symmetry: str = "none", *, particles: int = PosteriorConfig.particles
) -> Fit:
    """How a reward model of that name (`kinds.ModelName`) is fitted. particles: of a posterior."""
    settings = FitSettings(reduction, seed, symmetry == "left_right", particles)
    return lambda preferences: FITTINGS[model].fit(preferences, settings)


QUICK_PARTICLES = 4_000  # of the posteriors that only predict held-out answers: a participant may be waiting
FOLDS = 5
SLOW_FOLDS = 3  # of what takes longer to fit, as networks do


def prediction_of(
    answers: tuple[Artefact, Snapshot],
    of_participant: Mapping[str, Sequence[Preference]],
    model: str,
    *,
    reduction: Reduction = "sum",
    seed: int,
    symmetry: str = "none",
) -> Prediction:
    """How well models of that name predict these answers where they did not see them, against chance and majority.

    Pairs that ratings imply share trajectories: predictions of them are not independent, and a little too good.
    """
    fit = fit_of(model, reduction, seed, symmetry, particles=QUICK_PARTICLES)
    training = answers[1].training_answers()  # none where trajectories were only rated
    return predictions(
        [preference for of_one in of_participant.values() for preference in of_one],
        fit,
        majority=majority_share(
            [answer.choice for answer in training],
            [answer.chosen for answer in training],
            [answer.rejected for answer in training],
        )
        if training
        else CHANCE,
        people=len(of_participant),
        folds=SLOW_FOLDS if FITTINGS[model].takes_long else FOLDS,
        seed=seed,
    )


def posterior_of_person(
    of_participant: Mapping[str, Sequence[Preference]], symmetry: str = "none", before: WeightPrior | None = None
) -> tuple[FreePosterior, PredictiveCheck] | None:
    """What is believed of the one person whose independent answers these are, by the light of what others weigh, and
    whether they look like it; None of several people, and where nothing about two different trajectories was
    answered."""
    if len(of_participant) != 1:
        return None
    try:
        setup, used = usable(next(iter(of_participant.values())), fewest=1)
    except TooFewAnswers:
        return None
    mirrored = symmetry == "left_right"
    pairs = [(preference.chosen, preference.rejected) for preference in used]
    return check_answers(
        PairDifferences.of(setup.name, pairs, left_right_symmetry=mirrored),
        np.ones(len(used), dtype=np.bool_),
        FreeConfig(posterior=PosteriorConfig(left_right_symmetry=mirrored)),
        before,
    )


def earlier_people(context: JobContext, snapshots: str, setup: str, symmetry: str = "none") -> list[EarlierPerson]:
    """Whoever answered before, of snapshots by id, with commas between. Who was erased since is left out: their
    snapshot is gone or locked away."""
    mirrored, people = symmetry == "left_right", []
    for reference in snapshots.split(",") if snapshots else []:
        try:
            _, snapshot = snapshot_of(context, reference.strip())
        except ArtefactError as gone:
            log.warning("earlier answers are gone", problem=str(gone))
            continue
        if snapshot.setup != setup:
            continue
        for preferences in preferences_of(context, snapshot, independent=True).values():
            pairs = [(preference.chosen, preference.rejected) for preference in preferences if not preference.is_tie]
            if not pairs:
                continue
            differences = PairDifferences.of(setup, pairs, left_right_symmetry=mirrored)
            people.append(EarlierPerson(differences, np.ones(len(pairs), dtype=np.bool_)))
    return people


def describe_model(model: RewardModel) -> dict[str, Any]:
    """Which kind of model it became, and what the answers were about, where it can say so."""
    importance = model.importance()
    return {"kind": model.kind} | ({"importance": importance} if importance else {})


def keep_reward_model(
    context: JobContext,
    params: Params,
    answers: tuple[Artefact, Snapshot],
    model: RewardModel,
    *,
    name: str,
    reduction: str,
    results: dict[str, Any],
) -> str:
    """Store a fitted model with its card; returns its id. name: the kind that was asked for."""
    artefact, snapshot = answers
    return keep(
        context,
        kind="reward_model",
        name=f"{name} reward model: {artefact.name}, seed {params.model_dump()['seed']}",
        setup=snapshot.setup,
        content=model.to_bytes(),
        params=params,
        config={"model": name, "reduction": reduction},
        results=results,
        parents=[(artefact, "answers")],
    )
