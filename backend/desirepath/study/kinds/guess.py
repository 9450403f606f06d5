"""Kind of step `guess`: after the blind comparison, which trajectory of its last pair came from the own answers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from sqlalchemy import select

from desirepath.store.models import Trial
from desirepath.store.sides import Side
from desirepath.study.kind import Acting, Kind, Moment, Page, Simulated
from desirepath.study.steps import Step
from desirepath.study.wire import ChoiceAnswer


class GuessStep(Step):
    """Planned by the stage `comparison`."""

    kind: Literal["guess"]


class Guess(Kind[GuessStep, ChoiceAnswer]):
    name = "guess"
    step = GuessStep
    answers = ChoiceAnswer
    stored = {"choice": "a or b", "about": "step of the comparison", "right": "whether it came from the own answers"}

    def is_asked(self, step: GuessStep, moment: Moment) -> bool:
        """Where a comparison was shown: without one there is nothing to guess."""
        return moment.session.personalisation == "shown"

    def may_come(self, step: GuessStep, moment: Moment) -> bool:
        return moment.session.personalisation in (None, "shown")

    def payload(self, step: GuessStep, page: Page) -> dict[str, Any]:
        return {"learns_from": page.frozen.learns_from}

    def check(self, step: GuessStep, answer: ChoiceAnswer, page: Page) -> dict[str, Any]:
        return {"choice": answer.choice}

    def keep(self, step: GuessStep, acting: Acting, stored: dict[str, Any]) -> dict[str, Any]:
        """What the guess is about: the pair just seen, and whether the trajectory named came from their answers."""
        last = acting.s.scalars(
            select(Trial)
            .where(Trial.session_id == acting.session.id, Trial.kind == "comparison")
            .order_by(Trial.index.desc())
            .limit(1)
        ).first()
        return {"about": last.step_key, "right": (last.arms or {})["own"] == stored["choice"]} if last else {}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        side: Side = "ab"[int(participant.random.integers(2))]  # type: ignore[assignment]
        return {"choice": side}


KIND = Guess()
