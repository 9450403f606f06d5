"""Kind of step `comparison`: the own policy against the base policy or another's in a new scene, blind.

The trials are made when the policy is there (`personalising/alignment_jobs.py`); comparisons without one are passed
over.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from pydantic import AliasChoices, Field, field_validator

from desirepath.grammar.words import View
from desirepath.study.kinds.base import Kind, Moment, Pace, Page, Planning, Simulated, Stage, Step
from desirepath.study.kinds.guess import GuessStep
from desirepath.study.kinds.trial import Viewing
from desirepath.study.kinds.wire import AboutQuery, ChoiceAnswer


class ComparisonStage(Stage):
    """Base policy and own policy in `scenes` new scenes, blind, sides drawn by lot in each; then, if `guess`, which
    trajectory of the last pair came from the participant's own answers. Who drew paths sees `dwa`, the dynamic window
    approach (ch. 2), in place of `base`.

    `other`: in `scenes` further scenes the own policy against that of another participant (yoked): one that is ready
    and was lent to nobody else yet, where there is one, so that people who finish together are lent different ones. Who
    prefers the own one there does not merely like what everybody likes. `stand_ins`: before there is one, a simulated
    person's is lent, from the setup's card. `neutral`: likewise against the conditioned policy without preferences,
    which is of the own one's kind (own against base compares two kinds of policy, too).
    """

    once = True
    for_everybody = True

    arms: tuple[Literal["base", "dwa", "neutral", "own", "other"], ...] = ("base", "own")
    scenes: int = Field(3, ge=1, le=10)
    stand_ins: bool = False
    blind: Literal[True] = True
    view: View | None = Field(None, description="default: the view of the block before")
    guess: bool = True

    @field_validator("arms")
    @classmethod
    def _can_be(cls, arms: tuple[str, ...]) -> tuple[str, ...]:
        if arms != ("dwa", "own"):
            in_order = tuple(arm for arm in ("base", "neutral", "own", "other") if arm in arms)
            if arms != in_order or "own" not in arms or len(arms) < 2:
                raise ValueError("must be [dwa, own], or own and some of the others of [base, neutral, own, other]")
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
                    **({"against": opponent} if opponent in ("neutral", "other") else {}),
                }
            )
            for number, opponent in enumerate(against, 1)
        ]
        return [*shown, GuessStep(kind="guess", key=f"{at.key}.guess", stage=at.key)] if self.guess else shown

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        return self.pairs * pace.trial_s

    def numbers(self) -> dict[str, int]:
        return {"comparison_pairs": self.pairs}


class ComparisonStep(Step):
    """sides_swapped: the own policy's trajectory is shown as A. against: base (also DWA), neutral or other."""

    kind: Literal["comparison"]
    number: int
    of: int
    sides_swapped: bool = Field(validation_alias=AliasChoices("sides_swapped", "turned"))
    against: Literal["base", "neutral", "other"] = "base"


class Comparison(Kind[ComparisonStep, ChoiceAnswer]):
    name = "comparison"
    step = ComparisonStep
    answers = ChoiceAnswer
    besides = AboutQuery
    stored = {"choice": "a or b"}
    stages = {"comparison": ComparisonStage}
    shows = "trajectories"
    previewed = True

    def payload(self, step: ComparisonStep, page: Page) -> dict[str, Any]:
        shown = {"role": "regular", "view": step.view, "number": step.number, "of": step.of}
        return shown | Viewing().model_dump()

    def is_asked(self, step: ComparisonStep, moment: Moment) -> bool:
        return moment.has_trial(step.key)

    def check(self, step: ComparisonStep, answer: ChoiceAnswer, page: Page) -> dict[str, Any]:
        return {"choice": answer.choice}

    def known_to_simulated(self, step: ComparisonStep, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        return {"query": None}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        return {"choice": participant.choose(step, *participant.watch(step, "ab"))}


KIND = Comparison()
