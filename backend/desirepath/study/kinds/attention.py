"""Kind of step `attention`: a page among the trials that says which letter to press; preferences are never wrong."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from desirepath.store.sides import Side
from desirepath.study.kind import Kind, Moment, Page, Simulated
from desirepath.study.steps import Step
from desirepath.study.wire import Besides, ChoiceAnswer


class AttentionStep(Step):
    """Planned by blocks (`attention_checks`). instructed: the letter that the page says."""

    kind: Literal["attention"]
    instructed: Side
    number: int


class AboutAttention(Besides):
    instructed: Side | None = None


class Attention(Kind[AttentionStep, ChoiceAnswer]):
    name = "attention"
    step = AttentionStep
    answers = ChoiceAnswer
    besides = AboutAttention
    stored = {"choice": "a or b", "instructed": "the letter that the page said", "passed": "whether they are the same"}

    def payload(self, step: AttentionStep, page: Page) -> dict[str, Any]:
        return {"instructed": step.instructed}

    def check(self, step: AttentionStep, answer: ChoiceAnswer, page: Page) -> dict[str, Any]:
        passed = answer.choice == step.instructed
        return {"choice": answer.choice, "instructed": step.instructed, "passed": passed}

    def tell_simulated(self, step: AttentionStep, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        return {"instructed": step.instructed}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        return {"choice": step["instructed"]}


KIND = Attention()
