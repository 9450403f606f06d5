"""A frozen protocol as steps and learning go by it. The whole is `protocol`'s, which knows the kinds of step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from pydantic import Field

from desirepath.grammar.parts import Part, Slug, Value
from desirepath.grammar.questionnaires import Questionnaire
from desirepath.study.plan.asked_queries import Sample
from desirepath.study.plan.counterbalancing import Assigning
from desirepath.study.steps import T

Prior = Literal["none", "earlier_participants", "people_in_general"]
"""By the light of what own answers are read."""


class Quota(Part):
    """At most `most` participants (completed or under way) may give this answer; who comes later leaves kindly."""

    questionnaire: Slug
    item: Slug
    is_: Value = Field(alias="is")
    most: int = Field(ge=0)


@dataclass(frozen=True)
class Training:
    """What a protocol says about learning from its own answers, gathered from the stages that say it.

    prior: what own answers are read by the light of. scenes: of the comparison, 0 where there is none; opponents: of
    the own policy in it; stand_ins: lend while nobody's is ready. rated: rollouts are rated one by one. environments:
    that paths are drawn in, in the order of the stages.
    """

    job: Literal["align", "demonstrations"]
    recipe: str
    prior: Prior
    give_up_after_s: int
    scenes: int
    opponents: tuple[str, ...]
    stand_ins: bool
    rated: bool
    environments: tuple[str, ...]

    @property
    def learns_from(self) -> Literal["answers", "paths"]:
        return "paths" if self.job == "demonstrations" else "answers"


class Rules(Assigning, Protocol):
    """The protocol's own keys."""

    @property
    def quotas(self) -> Sequence[Quota]: ...
    @property
    def symmetry(self) -> str: ...
    @property
    def sample(self) -> Sample: ...


class Frozen(Protocol):
    """The protocol and the files that it names."""

    @property
    def protocol(self) -> Rules: ...
    @property
    def questionnaires(self) -> Mapping[str, Questionnaire]: ...
    @property
    def training(self) -> Training | None: ...
    @property
    def learns_from(self) -> str: ...

    def text(self, name: str, language: str) -> tuple[str, str]: ...
    def stage(self, kind: type[T]) -> T: ...
    def consent_hash(self, language: str) -> str: ...
