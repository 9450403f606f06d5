"""Kind of step `feedback`: after an answer, the way that the robot would drive now that it has learned from it.

A condition of its own (`feedback` of a block, `protocol/block.py`): whoever meets it answers nothing blind.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from desirepath.grammar.parts import Part
from desirepath.grammar.source import Path, Problem, Source
from desirepath.grammar.words import View
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.events import log_event
from desirepath.study.kind import Acting, Moment, Page, Simulated
from desirepath.study.kinds.comparison import ComparisonStage
from desirepath.study.kinds.evaluation import EvaluationStage
from desirepath.study.kinds.live import LiveKind, LiveStep, Setup, Weights, find_arrival_notes
from desirepath.study.kinds.trial import TrialStep
from desirepath.study.personalising.believed import find_belief
from desirepath.study.personalising.live_rollouts import condition_on
from desirepath.study.steps import Stage, Step
from desirepath.study.wire import STORED_IN_ROOM, Flag, InRoomAnswer

if TYPE_CHECKING:
    from desirepath.learning.policies.policy import DrivingPolicy

TAKES_S = 8.0  # ours
BEGAN = "feedback_shown"


class Feedback(Part):
    """After every regular answer of a block: how the robot would drive now, each time in the same scene of `setup`."""

    setup: Setup = "study_room"
    view: View = "top_down"

    def after_each(self, prefix: str, where: Mapping[str, Any], steps: Sequence[Step]) -> Iterator[Step]:
        """The block's steps with one of these after each regular trial."""
        number, of = 0, sum(isinstance(step, TrialStep) and step.role == "regular" for step in steps)
        for step in steps:
            yield step
            if isinstance(step, TrialStep) and step.role == "regular":
                number += 1
                shown = {"setup": self.setup, "scenes": 1, "view": self.view, "after": step.key}
                fields = {"kind": "feedback", "key": f"{prefix}.feedback_{number:02d}", "number": number, "of": of}
                yield FeedbackStep.model_validate({**where, **fields, **shown})


def check_beside_blind(stages: Sequence[Stage], here: Path, source: Source) -> Iterator[Problem]:
    """What cannot stand in a protocol of which a block shows what was learned. here: that block's `feedback`."""
    for stage in stages:
        what = None
        if isinstance(stage, ComparisonStage | EvaluationStage):
            what = "a blind comparison of robots, of which one would be known"
        elif stage.teaches == "align" and getattr(stage, "feedback", None) is None:
            what = "blind answers, to which nothing was shown"
        if what is not None:
            yield source.problem(here, f"cannot stand in a protocol with {what}; make it a study of its own")


class FeedbackStep(LiveStep):
    """after: the key of the trial whose answer it follows. number, of: this one among its like."""

    kind: Literal["feedback"]
    after: str
    number: int
    of: int


class FeedbackAnswer(InRoomAnswer):
    """watched: whether the robot was let drive to its end."""

    watched: Flag = False
    seconds: float = Field(0.0, ge=0, le=24 * 3600, allow_inf_nan=False, description="since the page was opened")


class FeedbackKind(LiveKind[FeedbackStep, FeedbackAnswer]):
    name = "feedback"
    step = FeedbackStep
    answers = FeedbackAnswer
    stored = {
        "after": "key of the trial whose answer it followed",
        "weights": "objective -> weight: what the robot that was shown was conditioned on",
        "answers": "of how many answers that was learned",
        "watched": "whether it was let drive to its end",
        "seconds": "how long the page stood",
        **STORED_IN_ROOM,
    }

    def policies(
        self, step: FeedbackStep, moment: Moment, files: ArtefactStore, weights: Mapping[str, float] | None
    ) -> Sequence[DrivingPolicy]:
        """As it was learned when they came to the step, whatever is asked for."""
        return [condition_on(step.setup, find_arrival_notes(moment, step, BEGAN).get("weights", {}))]

    def payload(self, step: FeedbackStep, page: Page) -> dict[str, Any]:
        fields = {"setup": step.setup, "scenes": step.scenes, "view": step.view, "controls": (), "triangle": None}
        return fields | {"number": step.number, "of": step.of, "answers": step.number}

    def payload_now(self, step: FeedbackStep, moment: Moment) -> dict[str, Any]:
        noted = find_arrival_notes(moment, step, BEGAN)
        return {"answers": noted["answers"]} if "answers" in noted else {}

    def is_asked(self, step: FeedbackStep, moment: Moment) -> bool:
        """Not after a query that the stopping rule passed over."""
        return moment.has_trial(step.after)

    def arrive(self, step: FeedbackStep, acting: Acting) -> None:
        found = find_belief(acting.s, acting.files, acting.session)
        weights: Weights = found.weights if found is not None else {}
        answers = found.answers if found is not None else 0
        log_event(acting.s, BEGAN, session_id=acting.session.id, step=step.key, weights=weights, answers=answers)

    def check(self, step: FeedbackStep, answer: FeedbackAnswer, page: Page) -> dict[str, Any]:
        return {"watched": answer.watched, "seconds": round(answer.seconds, 3)}

    def keep(self, step: FeedbackStep, acting: Acting, stored: dict[str, Any]) -> dict[str, Any]:
        noted = find_arrival_notes(acting, step, BEGAN)
        return {"after": step.after, "weights": noted.get("weights", {}), "answers": noted.get("answers", 0)}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        return {"watched": True}


KIND = FeedbackKind()
