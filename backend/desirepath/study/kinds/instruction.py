"""Kind of step `instruction`: a page that says what to do next; in blocks one per condition."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from desirepath.grammar.conditions import Condition
from desirepath.grammar.parts import FileName, an_example
from desirepath.study.kinds.text_page import TextPage, TextStage, TextStep
from desirepath.study.steps import BlockPart, Planning, Step
from desirepath.study.wire import Confirmed


class BlockText(BlockPart):
    """A page of text in a block; `text` may hold the block's factors in braces: `texts/instruction_{view}.md`."""

    model_config = an_example({"text": "texts/instruction.md"})

    text: FileName

    def step(self, prefix: str, place: str, condition: Condition, where: Mapping[str, Any]) -> Step:
        fields = {"kind": "instruction", "key": f"{prefix}.{place}", **where, "text": condition.filled(self.text)}
        return InstructionStep.model_validate(fields)


class InstructionStage(TextStage):
    """A page of text; `text` names a markdown file with one variant per language (`instruction.en.md`)."""

    model_config = an_example({"text": "texts/instruction.md"})

    def plan(self, at: Planning) -> list[Step]:
        return [InstructionStep(kind="instruction", key=at.key, stage=at.key, text=self.text)]


class InstructionStep(TextStep):
    kind: Literal["instruction"]


class Instruction(TextPage[InstructionStep, Confirmed]):
    name = "instruction"
    step = InstructionStep
    stages = {"instruction": InstructionStage}
    block_parts = {"instruction": BlockText}


KIND = Instruction()
