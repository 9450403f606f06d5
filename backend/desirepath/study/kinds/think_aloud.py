"""Kind of step `think_aloud`: somebody says aloud what went through their mind, recorded by their own browser.

It has a consent of its own; who refuses, or has no microphone, goes on without. What comes in is `study/voices.py`'s.
Nobody's words are written down by a service.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from pydantic import Field

from desirepath.grammar.conditions import Condition
from desirepath.grammar.parts import FileName, an_example
from desirepath.study import voices
from desirepath.study.kind import Acting, Page, Simulated
from desirepath.study.kinds.text_page import TextPage, TextStep
from desirepath.study.steps import BlockPart, Pace, Planning, Stage, Step
from desirepath.study.wire import Answer, Flag

MOST_MINUTES = 15  # ours


class BlockThinkAloud(BlockPart):
    """Say aloud what one thought, once per condition; `text` may hold the block's factors in braces."""

    model_config = an_example({"text": "texts/instruction.md", "minutes": 3})

    text: FileName
    minutes: int = Field(3, ge=1, le=MOST_MINUTES)

    def step(self, prefix: str, place: str, condition: Condition, where: Mapping[str, Any]) -> Step:
        fields = {"text": condition.filled(self.text), "minutes": self.minutes}
        return ThinkAloudStep.model_validate({"kind": "think_aloud", "key": f"{prefix}.{place}", **where, **fields})


class ThinkAloudStage(Stage):
    """Say aloud what one thought. text: what to speak about; minutes: the longest recording."""

    model_config = an_example({"text": "texts/instruction.md", "minutes": 3})

    asks = True

    text: FileName
    minutes: int = Field(3, ge=1, le=MOST_MINUTES)

    def plan(self, at: Planning) -> list[Step]:
        fields = {"key": at.key, "stage": at.key, "text": self.text, "minutes": self.minutes}
        return [ThinkAloudStep.model_validate({"kind": "think_aloud", **fields})]

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        return pace.page_s + 60.0 * self.minutes / 2  # ours: half of the longest


class ThinkAloudStep(TextStep):
    kind: Literal["think_aloud"]
    minutes: int = 3


class ThinkAloudAnswer(Answer):
    """agreed: to be recorded. problem: why there is no recording although they agreed."""

    agreed: Flag
    problem: Literal["", "denied", "missing", "lost"] = ""


class ThinkAloud(TextPage[ThinkAloudStep, ThinkAloudAnswer]):
    name = "think_aloud"
    step = ThinkAloudStep
    answers = ThinkAloudAnswer
    stages = {"think_aloud": ThinkAloudStage}
    block_parts = {"think_aloud": BlockThinkAloud}
    stored = {
        "agreed": "whether they agreed to be recorded, here",
        "problem": "denied or missing: no microphone; lost: the recording did not come through; else empty",
        "recording": "sha256 of the recording (WebM, Opus) in `recordings/`, null: there is none",
        "bytes": "its size",
        "seconds": "from its first part to its last, by the server's clock",
    }

    def payload(self, step: ThinkAloudStep, page: Page) -> dict[str, Any]:
        return super().payload(step, page) | {"minutes": step.minutes}

    def check(self, step: ThinkAloudStep, answer: ThinkAloudAnswer, page: Page) -> dict[str, Any]:
        return {"agreed": answer.agreed, "problem": answer.problem if answer.agreed else ""}

    def keep(self, step: ThinkAloudStep, acting: Acting, stored: dict[str, Any]) -> dict[str, Any]:
        voice = voices.voice_of(acting.s, acting.session, step.key)
        if voice is None or not voice.sha or not stored["agreed"]:
            voices.forget(acting.s, acting.files, acting.session, step.key)
            return {"recording": None, "bytes": 0, "seconds": 0.0}
        return {"recording": voice.sha, "bytes": voice.bytes, "seconds": voice.seconds}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        return {"agreed": False}


KIND = ThinkAloud()
