"""Kind of step `information`: a page of text before or between what is asked."""

from __future__ import annotations

from typing import Literal

from desirepath.grammar.parts import an_example
from desirepath.study.kinds.text_page import TextPage, TextStage, TextStep
from desirepath.study.steps import Planning, Step
from desirepath.study.wire import Confirmed


class InformationStage(TextStage):
    """A page of text; `text` names a markdown file with one variant per language (`information.en.md`)."""

    model_config = an_example({"text": "texts/information.md"})

    def plan(self, at: Planning) -> list[Step]:
        return [InformationStep(kind="information", key=at.key, stage=at.key, text=self.text)]


class InformationStep(TextStep):
    kind: Literal["information"]


class Information(TextPage[InformationStep, Confirmed]):
    name = "information"
    step = InformationStep
    stages = {"information": InformationStage}


KIND = Information()
