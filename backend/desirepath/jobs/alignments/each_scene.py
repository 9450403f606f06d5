"""In each scene the policy of the library whose rollout there the answers let expect most of; there in seconds. Behind
it `each_scene_trained` adds one that is trained on what they say."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from desirepath.jobs.alignment import Aligned, Alignment, ConditionedAlignParams
from desirepath.jobs.params import MOST_NAMED, from_source

if TYPE_CHECKING:
    from collections.abc import Callable

    from desirepath.jobs.context import JobContext
    from desirepath.learning.alignment.own_reward import OwnRewardResult
    from desirepath.learning.policies.choosing import Answers
    from desirepath.learning.policies.policy import Policy
    from desirepath.learning.rewards.reward_model import RewardModel
    from desirepath.store.models import Artefact


class ChoiceParams(ConditionedAlignParams):
    """What is asked where a policy is chosen per scene.

    policies: how many it has to choose from, beside the base policy. population: in so many further scenes it is
    compared with the policy by what earlier participants want; people: their snapshots, the newest first.
    """

    gate_scenes: int = from_source("ours_known_rollouts", 50, ge=50, le=5_000, advanced=True)
    policies: int = from_source("ours", 24, ge=1, le=99, advanced=True)
    population: int = from_source("from_protocol_population", 0, ge=0, le=10, advanced=True)
    people: str = from_source("from_protocol_population", "", advanced=True, max_length=MOST_NAMED)


class EachSceneParams(ChoiceParams):
    """In each scene the policy of the library whose rollout there the answers let expect most of."""

    recipe: Literal["each_scene"] = from_source("ours_each_scene", "each_scene")


def align(context: JobContext, params: EachSceneParams, base: Policy, model: RewardModel) -> Aligned:
    """Raises as `choose`."""
    del model  # both posteriors are this one's own
    return choose(context, params, base)


def choose(
    context: JobContext,
    params: ChoiceParams,
    base: Policy,
    train: Callable[[Answers], OwnRewardResult] | None = None,
) -> Aligned:
    """train: what else there is to choose from. Raises LearningError for answers of several people, for a setup without
    policy library, and for policies that the library was not made from."""
    from desirepath.jobs.aligned import gate_rule
    from desirepath.jobs.answers import preferences_of, snapshot_of
    from desirepath.learning.alignment.each_scene import answers_of, choose_each_scene, what_they_weigh
    from desirepath.learning.alignment.gate import at_gate
    from desirepath.learning.cards import DEPARTURES
    from desirepath.learning.errors import LearningError
    from desirepath.learning.policies.choosing import Before
    from desirepath.learning.policies.shipped import load_policy
    from desirepath.learning.preferences.people_in_general import people_in_general
    from desirepath.learning.preferences.population_prior import IN_GENERAL
    from desirepath.store.erasure import SEVERAL_PEOPLE

    shipped = load_policy(f"{base.setup}/base")
    if base.without_critic().digest() != shipped.without_critic().digest():
        raise LearningError(f"base = {params.base!r}: the policy library was made from {base.setup}/base alone")
    if params.conditioned not in (None, f"{base.setup}/conditioned"):
        raise LearningError(f"conditioned = {params.conditioned!r}: the library is of {base.setup}/conditioned alone")
    of_participant = preferences_of(context, snapshot_of(context, params.snapshot)[1], independent=True)
    if len(of_participant) != 1:
        count = len(of_participant)
        raise LearningError(f"recipe = {params.algorithm!r}: learns from the answers of one person, not of {count}")
    (preferences,) = of_participant.values()
    answers = answers_of(preferences, left_right_symmetry=params.symmetry == "left_right")
    people, snapshots = earlier_answers(context, params.earlier, params.symmetry, base.setup)
    before = Before(people_in_general(base.setup)) if params.prior == IN_GENERAL else what_they_weigh(people)
    answers = replace(answers, before=before)
    trained = train(answers) if train is not None else None
    beside = [trained.policy.without_critic()] if trained is not None else []
    policy = choose_each_scene(answers, kept=params.policies, beside=beside)
    context.progress(0.4 if trained is None else 0.85)
    gate = at_gate(policy, base, gate_rule(params), seed=params.seed)
    return Aligned(
        policy=policy,
        gate=gate,
        config={
            "recipe": params.algorithm,
            "policies": len(policy.policies),
            "answers": len(answers.chosen),
            "judged": "directly",
            **({SEVERAL_PEOPLE: len(people)} if people else {}),
            **({"trained": trained.as_dict()} if trained is not None else {}),
        },
        parents=[(snapshot, f"answers {number}") for number, snapshot in enumerate(snapshots, 1)],
        departures=[DEPARTURES["each_scene"], DEPARTURES["policy_library"], DEPARTURES["recovery"]],
        scenes={"select": trained.scenes} if trained is not None else {},
    )


def earlier_answers(
    context: JobContext, listed: str, symmetry: str, setup: str
) -> tuple[list[Answers], list[Artefact]]:
    """Whose answers there are of snapshots by id, with commas between, the newest first. Who was erased since is left
    out."""
    import structlog

    from desirepath.jobs.answers import preferences_of, snapshot_of
    from desirepath.learning.alignment.each_scene import MOST_PEOPLE, answers_of
    from desirepath.learning.errors import LearningError
    from desirepath.store.artefacts import ArtefactError

    people: list[Answers] = []
    snapshots: list[Artefact] = []
    for reference in listed.split(",") if listed else []:
        if len(people) == MOST_PEOPLE:
            break
        try:
            artefact, snapshot = snapshot_of(context, reference.strip())
            preferences = preferences_of(context, snapshot, independent=True)
            if snapshot.setup == setup and len(preferences) == 1:
                (of_one,) = preferences.values()
                people.append(answers_of(of_one, left_right_symmetry=symmetry == "left_right"))
                snapshots.append(artefact)
        except (ArtefactError, LearningError) as gone:
            structlog.get_logger("desirepath.jobs").warning("earlier answers are gone", problem=str(gone))
    return people, snapshots


ALIGNMENT = Alignment(EachSceneParams, "policy per scene", align, asks_directly=True)
