"""Kind of step `asking_on`: a page that says why a few more pairs are asked, where answers do not say surely enough yet
what somebody prefers. Planned by the stage `train` where its protocol says `ask_on`; the pairs are of `trial.py`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
from pydantic import Field

from desirepath.grammar.parts import Part
from desirepath.grammar.words import View
from desirepath.study.kind import Kind, Moment, Page
from desirepath.study.kinds.trial import ChooseBy, TrialStep
from desirepath.study.personalising import alignment_jobs
from desirepath.study.steps import Pace, Step
from desirepath.study.wire import Confirmed


class AskOn(Part):
    """Further pairs where what was learned is not surely better for this very person: `each` at a time, then it is
    learned and judged again, until it is or `at_most` were asked. Their answers teach and are marked (role `further`);
    no analysis counts them. choose: as of a block's queries.
    """

    at_most: int = Field(ge=1, le=200)
    each: int = Field(5, ge=1, le=50)  # ours
    choose: ChooseBy = "information_beyond"
    view: View | None = Field(None, description="default: the view of the block before")

    @property
    def rounds(self) -> list[int]:
        """How many pairs each round asks."""
        whole = math.ceil(self.at_most / self.each)
        return [min(self.each, self.at_most - k * self.each) for k in range(whole)]

    def seconds(self, pace: Pace) -> float:
        """What all of them take."""
        return self.at_most * pace.trial_s + len(self.rounds) * pace.page_s

    def round_steps(self, stage: str, place: int, view: View, random: np.random.Generator) -> Iterator[Step]:
        """The page and the pairs of one round, `place` from 1; the last answer begins the training anew."""
        pairs, key = self.rounds[place - 1], f"{stage}.more_{place}"
        left = self.at_most - sum(self.rounds[: place - 1])
        yield AskingOnStep(kind="asking_on", key=key, stage=stage, round=place, pairs=pairs, at_most=left)
        for number in range(1, pairs + 1):
            fields = {
                "kind": "trial",
                "key": f"{key}.{number:02d}",
                "stage": stage,
                "block": stage,
                "view": self.view or view,
                "role": "further",
                "round": place,
                "number": number,
                "of": pairs,
                "sides_swapped": bool(random.integers(2)),
                "choose": self.choose,
                **({"then": "train_again"} if number == pairs else {}),
            }
            yield TrialStep.model_validate(fields)


class AskingOnStep(Step):
    """round: from 1; pairs: that it asks; at_most: these and those of the rounds that may follow."""

    kind: Literal["asking_on"]
    round: int
    pairs: int
    at_most: int

    @property
    def further(self) -> bool:
        return True


class AskingOn(Kind[AskingOnStep, Confirmed]):
    name = "asking_on"
    step = AskingOnStep
    begun = {"train_again": alignment_jobs.start_training_again}

    def payload(self, step: AskingOnStep, page: Page) -> dict[str, Any]:
        return {"pairs": step.pairs, "at_most": step.at_most, "first": step.round == 1}

    def is_asked(self, step: AskingOnStep, moment: Moment) -> bool:
        return moment.session.personalisation is None

    def may_come(self, step: AskingOnStep, moment: Moment) -> bool:
        return False  # most are never asked; who is, is told how many more there are


KIND = AskingOn()
