"""Kind of step `break`: a rest that can be ended after a while."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from pydantic import Field

from desirepath.grammar.conditions import Condition
from desirepath.grammar.parts import FileName, an_example
from desirepath.study.kind import Moment, Page, seconds_left
from desirepath.study.kinds.text_page import TextPage, TextStep
from desirepath.study.steps import BlockPart, Pace, Planning, Stage, Step
from desirepath.study.wire import Confirmed


class BlockBreak(BlockPart):
    """A rest; it can be ended after `at_least_s` seconds."""

    model_config = an_example({"text": "texts/interface_break.md", "at_least_s": 30})

    text: FileName
    at_least_s: int = Field(0, ge=0, le=1800)

    def step(self, prefix: str, place: str, condition: Condition, where: Mapping[str, Any]) -> Step:
        fields = {"text": condition.filled(self.text), "at_least_s": self.at_least_s}
        return BreakStep.model_validate({"kind": "break", "key": f"{prefix}.{place}", **where, **fields})


class BreakStage(Stage):
    """A rest; it can be ended after `at_least_s` seconds."""

    model_config = an_example({"text": "texts/interface_break.md", "at_least_s": 30})

    text: FileName
    at_least_s: int = Field(0, ge=0, le=1800)

    def plan(self, at: Planning) -> list[Step]:
        return [BreakStep(kind="break", key=at.key, stage=at.key, text=self.text, at_least_s=self.at_least_s)]

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        return pace.page_s + self.at_least_s


class BreakStep(TextStep):
    kind: Literal["break"]
    at_least_s: int = 0

    def least_s(self, *, timed_out: bool) -> int:
        return self.at_least_s


class Break(TextPage[BreakStep, Confirmed]):
    name = "break"
    step = BreakStep
    stages = {"break": BreakStage}
    block_parts = {"break": BlockBreak}

    def payload(self, step: BreakStep, page: Page) -> dict[str, Any]:
        return super().payload(step, page) | {"at_least_s": step.at_least_s}

    def payload_now(self, step: BreakStep, moment: Moment) -> dict[str, Any]:
        return {"at_least_s": seconds_left(step.at_least_s, moment)}


KIND = Break()
