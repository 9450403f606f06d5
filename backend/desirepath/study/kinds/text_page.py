"""What pages of text share: information, instruction, and what else shows a markdown text. No kind by itself."""

from __future__ import annotations

from typing import Any, Literal, TypeVar

from desirepath.grammar.parts import FileName
from desirepath.study.kind import Kind, Page
from desirepath.study.steps import Stage, Step
from desirepath.study.wire import Answer


class TextStep(Step):
    """A page of text. text: its file."""

    text: str

    @property
    def title_of(self) -> tuple[Literal["text", "questionnaire"], str] | None:
        return ("text", self.text)


class TextStage(Stage):
    """A page of text; `text` names a markdown file with one variant per language (`information.en.md`)."""

    text: FileName


S = TypeVar("S", bound=TextStep)
A = TypeVar("A", bound=Answer)


class TextPage(Kind[S, A]):
    """A kind whose page shows a text."""

    def payload(self, step: S, page: Page) -> dict[str, Any]:
        return page.show_text(step.text)
