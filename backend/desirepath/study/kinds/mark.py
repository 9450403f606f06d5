"""Kind of step `mark`: watch one trajectory and mark the moment at which something is not right, or is good, by a tap
while it plays; then, by choice, what it was (evaluative feedback on parts).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, FailFast, Field

from desirepath.grammar.conditions import Crossed
from desirepath.grammar.parts import Localized, an_example
from desirepath.grammar.source import Path
from desirepath.grammar.texts import local
from desirepath.grammar.words import TOLERANCE_S
from desirepath.store.marks import GOOD, MOST_MARKS, WHYS, Why
from desirepath.study.kind import Acting, Kind, Moment, Page, Simulated, make_trial
from desirepath.study.personalising.several_drives import durations_s
from desirepath.study.plan.asked_queries import Needs
from desirepath.study.steps import Pace, Planning, Stage, Step
from desirepath.study.wire import Answer, BadValue, Besides

SAYING_S = 6.0  # ours: what and why, of the one or two that people mark
LONGEST_S = 600.0  # of anything that is shown


class MarkStage(Crossed, Stage):
    """`count` trajectories, each watched once while moments in it are marked; once per condition, where there are
    several.

    good: what is good can be marked as well, by a button of its own; else only what is not right. question: what to
    watch out for. They are the first trajectories of queries that nothing else in the protocol shows, the same under
    every condition, in an order of each one's own. Marks count in the posterior of the session, each as the worst (or
    best) of the trajectory's parts; trainings learn from the choices between parts that they imply.
    """

    model_config = an_example({"view": "top_down", "count": 8})

    asks = True
    teaches = "align"
    sets_view = True

    count: int = Field(ge=1, le=100)
    good: bool = False
    question: Localized | None = Field(None, description="default: to press as soon as something is not right")

    def needs(self) -> Needs:
        return Needs(own=self.count)

    def trials_asked(self) -> int:
        return self.count

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        return self.count * len(self.conditions(0)) * (pace.trial_s / 2 + SAYING_S)

    def local_texts(self) -> Iterator[tuple[dict[str, str], Path]]:
        if self.question is not None:
            yield self.question, ("question",)

    def plan(self, at: Planning) -> list[Step]:
        pairs = at.drawn.pairs(self.count, shared=False)
        steps: list[Step] = []
        for condition in at.conditions:
            prefix = f"{at.key}.{condition.name}" if condition.name else at.key
            where = {"stage": at.key, "block": condition.name or at.key, **condition.shown}
            for number, i in enumerate(at.random.permutation(self.count), 1):
                fields = {"query": pairs[i].query, "trajectory": pairs[i].trajectory_a, "number": number}
                fields |= {"of": self.count, "good": self.good}
                fields |= {"question": self.question} if self.question else {}
                key = f"{prefix}.{number:02d}"
                steps.append(MarkStep.model_validate({"kind": "mark", "key": key, **where, **fields}))
        return steps


class MarkStep(Step):
    """One trajectory. query: that it is of; number, of: among its like; good, question: as of the stage."""

    kind: Literal["mark"]
    query: str
    trajectory: str
    number: int
    of: int
    good: bool
    question: dict[str, str] | None = None


class SentMark(BaseModel):
    """One moment."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    at_s: float = Field(
        ge=0, le=LONGEST_S, allow_inf_nan=False, strict=True, description="from the robot's first move to the tap"
    )
    why: Why | None = Field(None, description="null: nothing was said; good: it is good there, else it is not")


class MarkAnswer(Answer):
    marks: Annotated[list[SentMark], Field(max_length=MOST_MARKS), FailFast()] = Field(
        description="none: nothing was marked"
    )


class AboutMark(Besides):
    query: str | None = None
    good: bool | None = None


class Marking(Kind[MarkStep, MarkAnswer]):
    name = "mark"
    step = MarkStep
    answers = MarkAnswer
    besides = AboutMark
    stages = {"mark": MarkStage}
    stored = {
        "marks": "moments in the order of time: {at_s: seconds from the robot's first move to the tap, why: one of "
        f"{', '.join(WHYS)}, or null where nothing was said}}; empty: nothing was marked"
    }
    shows = "trajectories"
    trajectories = 1
    says_while_shown = True
    previewed = True

    def payload(self, step: MarkStep, page: Page) -> dict[str, Any]:
        shown = {name: getattr(step, name) for name in ("view", "number", "of", "good")}
        reasons = [why for why in WHYS if step.good or why != GOOD]
        question = local(step.question, page.language) if step.question else None
        return shown | {"question": question, "reasons": reasons, "most": MOST_MARKS}

    def arrive(self, step: MarkStep, acting: Acting) -> None:
        """Both trajectories of the trial are the one that is shown."""
        shown = {"trajectory_a": step.trajectory, "trajectory_b": step.trajectory}
        make_trial(acting, step, kind="mark", block=step.block, role="regular", query_id=step.query, **shown)

    def check(self, step: MarkStep, answer: MarkAnswer, page: Page) -> dict[str, Any]:
        if not step.good:
            for k, mark in enumerate(answer.marks):
                if mark.why == GOOD:
                    raise BadValue(f"value.marks.{k}.why", mark.why, "must say what is not right, or be null")
        in_time = sorted(answer.marks, key=lambda mark: mark.at_s)
        return {"marks": [{"at_s": round(mark.at_s, 2), "why": mark.why} for mark in in_time]}

    def keep(self, step: MarkStep, acting: Acting, stored: dict[str, Any]) -> dict[str, Any]:
        """Nothing more; refuses moments after the trajectory's end."""
        (longest_s,) = durations_s(acting.s, [step.trajectory])
        for k, mark in enumerate(stored["marks"]):
            if mark["at_s"] > longest_s + TOLERANCE_S:
                raise BadValue(f"value.marks.{k}.at_s", mark["at_s"], f"must be at most {longest_s:.1f} s")
        return {}

    def tell_simulated(self, step: MarkStep, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        return {"query": step.query, "good": step.good}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        return {"marks": participant.mark(step, good=step["good"])}


KIND = Marking()
