"""Kind of step `comprehension`: questions with one right answer each, asked again until they are, or the study ends."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Literal

from pydantic import Field
from sqlalchemy import select

from desirepath.grammar.parts import FileName, Slug, an_example
from desirepath.grammar.questionnaires import Questionnaire
from desirepath.grammar.skipping import is_asked
from desirepath.grammar.source import Path
from desirepath.grammar.when import Earlier
from desirepath.store.models import Response
from desirepath.study.kind import Moment, Page
from desirepath.study.kinds.questionnaire import Asking, AskingStep
from desirepath.study.steps import Planning, Stage, Step


class ComprehensionStage(Stage):
    """Questions with one right answer each (`correct`). Who errs `attempts` times leaves kindly (`end`) or goes on.

    text: a page of text that is shown above the questions again from the second attempt on.
    """

    model_config = an_example({"use": "comprehension", "attempts": 2, "text": "texts/instruction.md"})

    asks = True

    use: Slug
    attempts: int = Field(2, ge=1, le=5)
    on_failure: Literal["end", "go_on"] = "end"
    text: FileName | None = None
    time_limit_s: int | None = Field(None, ge=10, le=7200)

    def plan(self, at: Planning) -> list[Step]:
        fields = {"questionnaire": self.use, "attempts": self.attempts, "on_failure": self.on_failure}
        fields |= {"text": self.text} if self.text else {}
        fields |= {"time_limit_s": self.time_limit_s} if self.time_limit_s is not None else {}
        return [
            ComprehensionStep.model_validate(
                {"kind": "comprehension", "key": f"{at.key}.{n}", "stage": at.key, "attempt": n, **fields}
            )
            for n in range(1, self.attempts + 1)
        ]

    def questionnaires(self) -> Iterator[tuple[str, Path]]:
        yield self.use, ("use",)


class ComprehensionStep(AskingStep):
    kind: Literal["comprehension"]
    attempt: int
    attempts: int
    on_failure: Literal["end", "go_on"]
    text: str | None = None


class Comprehension(Asking[ComprehensionStep]):
    name = "comprehension"
    step = ComprehensionStep
    stored = {"ITEM": "answer by item", "passed": "whether all were right"}
    stages = {"comprehension": ComprehensionStage}

    def payload(self, step: ComprehensionStep, page: Page) -> dict[str, Any]:
        again = page.show_text(step.text)["text"] if step.text and step.attempt > 1 else None
        return super().payload(step, page) | {"attempt": step.attempt, "attempts": step.attempts, "again": again}

    def marks(self, questionnaire: Questionnaire, answers: dict[str, Any], earlier: Earlier | None) -> dict[str, Any]:
        checks = [item for item in questionnaire.items if item.correct is not None and is_asked(item, answers, earlier)]
        return {"passed": all(str(answers.get(item.key)) == item.correct for item in checks)}

    def is_asked(self, step: ComprehensionStep, moment: Moment) -> bool:
        return super().is_asked(step, moment) and (step.attempt == 1 or not _passed_before(step, moment))

    def may_come(self, step: ComprehensionStep, moment: Moment) -> bool:
        return step.attempt == 1 and super().may_come(step, moment)

    def ends(self, step: ComprehensionStep, moment: Moment, stored: Mapping[str, Any]) -> str | None:
        failed = not stored["passed"] and step.attempt == step.attempts
        return "comprehension" if failed and step.on_failure == "end" else None


def _passed_before(step: ComprehensionStep, moment: Moment) -> bool:
    earlier = [other.key for other in moment.plan if other.stage == step.stage and other.key != step.key]
    given = select(Response).where(Response.session_id == moment.session.id, Response.step_key.in_(earlier))
    return any(response.value.get("passed") for response in moment.s.scalars(given))


KIND = Comprehension()
