"""What a protocol may say about drawing paths and seeing what was learned from them: `demonstrations`, `evaluation`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from backend.study.grammar.parts import Part, Slug
from backend.study.grammar.words import PersonMode, View
from backend.study.protocol.blocks import Condition


class DemonstrationsStage(Part):
    """Paths are drawn in `pairs` situations of an environment (spec 02), `per_pair` in each and up to `up_to`.

    Situations come in an order drawn by lot, the first `pairs` of the environment's four.
    """

    environment: Literal["corridor", "room"]
    pairs: int = Field(4, ge=1, le=4)
    per_pair: int = Field(3, ge=1, le=10)  # spec 02: three to five
    up_to: int | None = Field(None, ge=1, le=10, description="default: per_pair, so that nothing is left open")
    view: View = "top_down"
    person: PersonMode = Field(
        "still",
        description="still: stands; walks: the participant walks in first person while the robot drives the path; "
        "recorded: the participant first chooses one of three walks that were planned by a program",
    )

    @model_validator(mode="after")
    def _counts_fit(self) -> DemonstrationsStage:
        if self.up_to is not None and self.up_to < self.per_pair:
            raise ValueError(f"up_to = {self.up_to} must be at least per_pair = {self.per_pair}")
        if self.person == "recorded" and self.view != "top_down":
            raise ValueError(
                f"view = {self.view!r} must be top_down with person: recorded: the walk is shown on the floor"
            )
        return self

    @property
    def most_per_pair(self) -> int:
        return self.up_to or self.per_pair


CONTROLLERS = ("social_cost", "dwa", "own")  # spec 02


class EvaluationStage(Part):
    """The social-cost planner, the dynamic window approach and the own controller, blind, one after the other, in the
    order of the assignment, and in the reverse order in the second environment, so that a participant meets each as
    late as the others on average: each drives in every situation that was drawn in, then `questionnaire` asks about it.
    """

    questionnaire: Slug
    view: View = "top_down"

    @property
    def each(self) -> dict[str, list[str]]:
        """What is ordered, as a block's `each`."""
        return {"controller": list(CONTROLLERS)}

    @property
    def one_of(self) -> None:
        """Everybody meets all three."""

    @property
    def groups(self) -> list[dict[str, str]]:
        """One, as of a block without `one_of`."""
        return [{}]

    def conditions(self, _group: int) -> list[Condition]:
        """The controllers as a block's conditions."""
        return [Condition(name=name, view=self.view, levels={"controller": name}) for name in CONTROLLERS]
