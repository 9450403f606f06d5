"""Kind of step `comparison`: the own policy against the base policy or another's in a new scene, blind.

The trials are made when the policy is there; comparisons without one are passed over.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, TypeVar

from pydantic import Field, field_validator

from desirepath.grammar.parts import an_example
from desirepath.grammar.words import View
from desirepath.store.job_results import AlignResult, Learned, Rollouts
from desirepath.store.models import TrajectoryRow, Trial
from desirepath.study.kind import Acting, Kind, Moment, Page, Simulated
from desirepath.study.kinds.guess import GuessStep
from desirepath.study.kinds.trial import Viewing
from desirepath.study.personalising import alignment_jobs
from desirepath.study.personalising.lending import policy_key
from desirepath.study.steps import Pace, Planning, Stage, Step
from desirepath.study.wire import AboutQuery, ChoiceAnswer

MADE_FOR = {"base": "comparisons", "neutral": "neutral", "population": "population", "other": "yoked"}
"""Opponent -> where a job's result has the rollouts against it."""


class ComparisonStage(Stage):
    """Base policy and own policy in `scenes` new scenes, blind, sides drawn by lot in each; then, if `guess`, which
    trajectory of the last pair came from the participant's own answers. Who drew paths sees `dwa`, the dynamic window
    approach (ch. 2), in place of `base`.

    `other`: in `scenes` further scenes the own policy against that of another participant (yoked): one that is ready
    and was lent to nobody else yet, where there is one, so that people who finish together are lent different ones. Who
    prefers the own one there does not merely like what everybody likes. `stand_ins`: before there is one, a simulated
    person's is lent, from the setup's card. `neutral`: likewise against the conditioned policy without preferences,
    which is of the own one's kind (own against base compares two kinds of policy, too). `population` (with recipe
    `each_scene`): likewise against the policy that chooses by what earlier participants want, made of those of the
    same study, version and group who consented to training; of five at least, where what it expects comes true for
    those who are left out of it.
    """

    model_config = an_example({"arms": ["base", "own"], "scenes": 3})

    once = True
    for_everybody = True

    arms: tuple[Literal["base", "dwa", "neutral", "population", "own", "other"], ...] = ("base", "own")
    scenes: int = Field(3, ge=1, le=10)
    stand_ins: bool = False
    blind: Literal[True] = True
    view: View | None = Field(None, description="default: the view of the block before")
    guess: bool = True

    @field_validator("arms")
    @classmethod
    def _can_be(cls, arms: tuple[str, ...]) -> tuple[str, ...]:
        if arms != ("dwa", "own"):
            in_order = tuple(arm for arm in ("base", "neutral", "population", "own", "other") if arm in arms)
            if arms != in_order or "own" not in arms or len(arms) < 2:
                arms_in_order = "[base, neutral, population, own, other]"
                raise ValueError(f"must be [dwa, own], or own and some of the others of {arms_in_order}")
        return arms

    @property
    def opponents(self) -> tuple[str, ...]:
        """What the own policy is compared with, `scenes` times each."""
        return tuple(arm for arm in self.arms if arm != "own")

    @property
    def pairs(self) -> int:
        """How many comparisons there are."""
        return self.scenes * len(self.opponents)

    def plan(self, at: Planning) -> list[Step]:
        against = [opponent for opponent in self.opponents for _ in range(self.scenes)]
        if len(self.opponents) > 1:
            against = [against[i] for i in at.random.permutation(len(against))]
        shown: list[Step] = [
            ComparisonStep.model_validate(
                {
                    "key": f"{at.key}.{number}",
                    "kind": "comparison",
                    "stage": at.key,
                    "view": self.view or at.view,
                    "number": number,
                    "of": len(against),
                    "sides_swapped": bool(at.random.integers(2)),
                    **({} if opponent in ("base", "dwa") else {"against": opponent}),
                }
            )
            for number, opponent in enumerate(against, 1)
        ]
        return [*shown, GuessStep(kind="guess", key=f"{at.key}.guess", stage=at.key)] if self.guess else shown

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        return self.pairs * pace.trial_s

    def numbers(self) -> dict[str, int]:
        return {"comparison_pairs": self.pairs}


class PairStep(Step):
    """Two robots in one scene. number, of: its place among its like."""

    number: int
    of: int


class ComparisonStep(PairStep):
    """sides_swapped: the own policy's trajectory is shown as A. against: base (also DWA), or which other arm."""

    kind: Literal["comparison"]
    sides_swapped: bool
    against: Literal["base", "neutral", "population", "other"] = "base"


S = TypeVar("S", bound=PairStep)


class BlindPair(Kind[S, ChoiceAnswer]):
    """Two robots in one scene, blind."""

    answers = ChoiceAnswer
    besides = AboutQuery
    shows = "trajectories"
    previewed = True

    def payload(self, step: S, page: Page) -> dict[str, Any]:
        shown = {"role": "regular", "view": step.view, "number": step.number, "of": step.of}
        return shown | Viewing().model_dump()

    def check(self, step: S, answer: ChoiceAnswer, page: Page) -> dict[str, Any]:
        return {"choice": answer.choice}

    def tell_simulated(self, step: S, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        return {"query": None}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        return {"choice": participant.choose(step, *participant.watch(step, "ab"))}


class Comparison(BlindPair[ComparisonStep]):
    name = "comparison"
    step = ComparisonStep
    stored = {"choice": "a or b"}
    stages = {"comparison": ComparisonStage}

    def is_asked(self, step: ComparisonStep, moment: Moment) -> bool:
        return moment.has_trial(step.key)


def make_comparisons(acting: Acting) -> int:
    """The comparison trials from the job's rollouts; sides as the plan's lot says. Returns how many there are."""
    s, session = acting.s, acting.session
    job = alignment_jobs.ready_job(s, session)
    result = job.result_as(Learned) if job is not None else None
    if job is None or result is None:
        return 0
    made: dict[str, Iterator[Rollouts]] = {
        against: iter(getattr(result, there, ())) for against, there in MADE_FOR.items()
    }
    count = 0
    for index, step in enumerate(acting.plan):
        if not isinstance(step, ComparisonStep):
            continue
        against = step.against
        rollouts = next(made[against], None)
        if rollouts is None:
            continue
        count += 1
        rival = s.get(TrajectoryRow, rollouts.of(against))
        policies = {"own": result.policy, against: rival.made_by if rival is not None else None}
        if job.kind == alignment_jobs.PATHS_JOB:
            policies["base"] = "dwa"  # which is no artefact
        a, b = ("own", against) if step.sides_swapped else (against, "own")
        arms: dict[str, Any] = {"a": policies[a], "b": policies[b], "own": "a" if a == "own" else "b"}
        if against != "base":
            arms[against] = "b" if a == "own" else "a"
        if against == "population" and isinstance(result, AlignResult) and result.in_general is not None:
            arms["people"] = result.in_general["people"]
        if against == "other" and policies["other"] is not None:
            arms["lent"] = policy_key(s, policies["other"])
            if job.params.get("other") is None:
                arms["stand_in"] = True
        s.add(
            Trial(
                session_id=session.id,
                step_key=step.key,
                index=index,
                block=step.stage,
                kind="comparison",
                view=step.view,
                trajectory_a=rollouts.of(a),
                trajectory_b=rollouts.of(b),
                arms={**arms, "look_alike": rollouts.look_alike},
                phase_since=acting.now,
            )
        )
    s.flush()
    return count


KIND = Comparison()
