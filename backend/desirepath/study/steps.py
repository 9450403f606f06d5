"""What kinds of step are planned by: a stage in the protocol, the steps that it means in a participant's plan.

Nothing here knows a kind by name, or a protocol as a whole: stages are handed what they plan with.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict

from desirepath.grammar.conditions import Condition, Ordered
from desirepath.grammar.parts import Part
from desirepath.grammar.source import Path, Problem, Source
from desirepath.grammar.when import When
from desirepath.grammar.words import View
from desirepath.study.plan.asked_queries import DrawnQueries, Needs

PAGE_S = 30.0  # ours: how long a page is read

# ---- in the protocol -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Pace:
    """What people take, seconds: a page; a trial of two trajectories, letters and choice; one trajectory alone."""

    page_s: float
    trial_s: float
    single_s: float


PACE = Pace(page_s=PAGE_S, trial_s=2 * (9.0 + 2.0) + 5.0, single_s=35.0)
"""ours: a drive of the study room's queries takes 9 s (ch. 7: 9.8 s and less) and 2 s for its letter, a choice 5 s;
alone, a rollout of 6 m at about 0.2 m/s and a press on the button."""


@dataclass
class Planning:
    """What a stage is planned with. key: the stage's own; stages: all of the protocol; conditions: in this
    participant's order, none where the stage has none; view: of the block before; drawn: this participant's queries.
    """

    key: str
    stages: Sequence[Stage]
    conditions: Sequence[Condition]
    view: View
    drawn: DrawnQueries
    random: np.random.Generator

    def of(self, stage: type[T]) -> list[T]:
        """The protocol's stages of that class."""
        return [planned for planned in self.stages if isinstance(planned, stage)]


class Stage(Part):
    """Base of what a protocol says about one of its stages. Class variables are what other stages must know of it."""

    asks: ClassVar[bool] = False
    """Asks something of the participant, so it stands after the consent."""
    teaches: ClassVar[Literal["align", "demonstrations"] | None] = None
    """Which job learns from what is answered there; a protocol needs one such stage at least."""
    measures: ClassVar[bool] = False
    """Asks what a study may be about by itself, though nothing learns from it."""
    once: ClassVar[bool] = False
    """Stands at most once in a protocol."""
    for_everybody: ClassVar[bool] = False
    """Cannot stand beside `when`."""
    sets_view: ClassVar[bool] = False
    """What follows without a view of its own is shown in this stage's."""
    begins: ClassVar[Literal["train"] | None] = None
    """What the answer before it begins (`Kind.begun`)."""
    draws: ClassVar[bool] = False
    """Paths are drawn, for which a phone is too small."""

    @property
    def views(self) -> set[View]:
        """What rooms are shown in, where the stage says so itself."""
        own: View | None = getattr(self, "view", None)
        groups = range(len(self.groups)) if isinstance(self, Ordered) else ()
        conditions = [condition for group in groups for condition in self.conditions(group)]  # type: ignore[attr-defined]
        return {view for view in (own, *(condition.view for condition in conditions)) if view is not None}

    def plan(self, at: Planning) -> list[Step]:
        """This participant's steps, in order."""
        raise NotImplementedError

    def own_name(self) -> str | None:
        """What the stage is called in plans; default its kind."""
        return None

    def needs(self) -> Needs:
        """What it needs of the query set."""
        return Needs()

    def trials_asked(self) -> int:
        """How many trials it asks under each of its conditions."""
        return 0

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        """How long it takes, breaks included, without what only some are asked (`further_seconds`)."""
        return pace.page_s

    def further_seconds(self, pace: Pace) -> float:
        """How long its further steps take at most (`Step.further`)."""
        return 0.0

    def numbers(self) -> dict[str, int]:
        """What it adds to the numbers that texts may name in braces (`protocol/schema.py`); `pairs_per_block`
        is a maximum, all others are sums.
        """
        return {}

    def texts(self) -> Iterator[tuple[str, Path]]:
        """(name of a markdown text, where in the stage it is named)."""
        text = getattr(self, "text", None)
        if text is not None:
            yield text, ("text",)

    def questionnaires(self) -> Iterator[tuple[str, Path]]:
        """(name of a questionnaire, where in the stage it is named)."""
        yield from ()

    def local_texts(self) -> Iterator[tuple[dict[str, str], Path]]:
        """Texts per language that stand in the protocol file itself, and where in the stage."""
        yield from ()

    def problems(self, here: Path, stages: Sequence[Stage], source: Source) -> Iterator[Problem]:
        """What its numbers cannot be together, or beside the other stages. here: its place in the file."""
        yield from ()


T = TypeVar("T", bound=Stage)


class BlockPart(Part):
    """Base of a page in a block's `before`, `after` or `between`."""

    def step(self, prefix: str, place: str, condition: Condition, where: Mapping[str, Any]) -> Step:
        """Its step under one condition. prefix: of the condition's keys; place: `before_1` and so on."""
        raise NotImplementedError

    def texts(self, conditions: Sequence[Condition]) -> Iterator[tuple[str, str]]:
        """(name of a markdown text, field that names it), one per condition that it differs in."""
        text = getattr(self, "text", None)
        if text is not None:
            for name in sorted({condition.filled(text) for condition in conditions}):
                yield name, "text"

    def questionnaires(self) -> Iterator[tuple[str, str]]:
        """(name of a questionnaire, field that names it)."""
        yield from ()


# ---- in the plan -----------------------------------------------------------------------------------------------------


class Step(BaseModel):
    """Base of a step in a participant's plan. key: unique in the plan; stage: the stage's; block: the condition's name.

    `worn`: whether the immersive view is seen with a headset, None: as the protocol's `device` says.
    `when`: not everybody meets it. `then`: what its answer begins. `rates`: its answer's field that is a number and
    rates what its trial shows; data sets and reports find ratings by it, reward models those of trials of kind
    `rating`. Plans are stored as JSON with what was set alone; what older plans say that nobody reads any more is
    passed over.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", populate_by_name=True)

    kind: str
    key: str
    stage: str
    block: str | None = None
    view: View | None = None
    worn: bool | None = None
    when: When | None = None
    then: Literal["train", "train_again"] | None = None
    rates: str | None = None

    def least_s(self, *, timed_out: bool) -> int:
        """How long its page must stand before it can be answered. timed_out: half filled, because its time is over."""
        return 0

    @property
    def further(self) -> bool:
        """Whether only those meet it whose answers do not tell enough yet (`kinds/asking_on.py`)."""
        return False

    @property
    def most_s(self) -> int | None:
        """How long it may be answered, if not for ever: what comes later counts as half filled."""
        return None

    @property
    def title_of(self) -> tuple[Literal["text", "questionnaire"], str] | None:
        """The text or questionnaire whose title names the step to experimenters, where there is one."""
        return None

    @property
    def sort(self) -> tuple[str, ...]:
        """What tells it from steps that look otherwise: a preview shows one of each sort."""
        return (self.stage, self.block or "", self.kind)

    def as_stored(self) -> dict[str, Any]:
        """The step as the session's plan holds it."""
        return self.model_dump(mode="json", by_alias=True, exclude_unset=True)
