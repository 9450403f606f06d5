"""Kind of step `debriefing`: the last page, with the completion code, the way back, and what concerns this person."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from desirepath.grammar.parts import Address, Code, FileName, an_example
from desirepath.study.kind import Acting, Ending, Moment, Page
from desirepath.study.kinds.text_page import TextPage, TextStep
from desirepath.study.links import code_and_way_back
from desirepath.study.personalising.about_person import about_person
from desirepath.study.steps import Planning, Stage, Step
from desirepath.study.wire import Confirmed


class DebriefingStage(Stage):
    """The last page. completion_code: `random`, or one code for everybody. return_url: may hold `{code}`."""

    model_config = an_example({"text": "texts/debriefing.md", "completion_code": "random"})

    for_everybody = True

    text: FileName
    completion_code: Code = "random"
    return_url: Address | None = None

    def plan(self, at: Planning) -> list[Step]:
        return [DebriefingStep(kind="debriefing", key=at.key, stage=at.key, text=self.text)]


class DebriefingStep(TextStep):
    kind: Literal["debriefing"]


class Debriefing(TextPage[DebriefingStep, Confirmed]):
    name = "debriefing"
    step = DebriefingStep
    stages = {"debriefing": DebriefingStage}

    def payload(self, step: DebriefingStep, page: Page) -> dict[str, Any]:
        ending = page.frozen.stage(DebriefingStage)
        return super().payload(step, page) | code_and_way_back(page.completion_code, ending.return_url)

    def payload_now(self, step: DebriefingStep, moment: Moment) -> dict[str, Any]:
        about = about_person(moment)
        return {"about": about} if about else {}

    def check_time(self, step: DebriefingStep, moment: Moment, value: Mapping[str, Any]) -> None:
        raise moment.refusal("finished", "This session is finished.")

    def arrive(self, step: DebriefingStep, acting: Acting) -> Ending:
        return Ending("complete", acting.frozen.stage(DebriefingStage).completion_code)


KIND = Debriefing()
