"""Kind of step `tuning`: the preference weights by hand, while the robot's way is redrawn at once.

The answer is where the weights end, with every change on the way there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from desirepath.grammar.parts import an_example
from desirepath.grammar.source import Path, Problem, Source
from desirepath.grammar.texts import local
from desirepath.store.events import log_event
from desirepath.study.kind import Acting, Moment, Page, Simulated
from desirepath.study.kinds.comparison import ComparisonStage
from desirepath.study.kinds.live import (
    AboutLive,
    AskedLiveStage,
    LiveAnswer,
    LiveKind,
    LiveStep,
    Weights,
    check_history,
    controls_of,
    find_arrival_notes,
    in_triangle,
    simulate_weights,
    slide,
    startable,
)
from desirepath.study.personalising.believed import find_belief
from desirepath.study.steps import Planning, Stage
from desirepath.study.wire import STORED_IN_ROOM

STARTED_RANDOMLY = 3  # of seven sliders, so that the start differs from neutral to the eye
BEGAN = "tuning_began"


class TuningStage(AskedLiveStage):
    """The participant sets the preference weights by sliders, or three of them in a triangle. start: none, or the
    triangle's middle (`neutral`), what the answers before it taught (`learned`), or drawn by lot (`random`).
    """

    model_config = an_example({"setup": "study_room", "scenes": 3})

    start: Literal["neutral", "learned", "random"] = "neutral"

    def plan(self, at: Planning) -> list[TuningStep]:  # type: ignore[override]  # a list of steps
        begins = _by_lot(at.random, self.setup, self.objectives) if self.start == "random" else {}
        if self.objectives and self.start == "neutral":
            begins = in_triangle({}, self.objectives)
        fields = self.step_fields | {"start": self.start} | ({"begins": begins} if begins else {})
        return [TuningStep.model_validate({"kind": "tuning", "key": at.key, "stage": at.key, **fields})]

    def problems(self, here: Path, stages: Sequence[Stage], source: Source) -> Iterator[Problem]:
        if self.start != "learned":
            return
        after = list(stages)[[stage is self for stage in stages].index(True) + 1 :]
        if any(isinstance(stage, ComparisonStage) for stage in after):
            message = "shows what was learned before the blind comparison; put it after that, or start neutral"
            yield source.problem((*here, "start"), message)
        if not any(stage.teaches == "align" for stage in stages if stage not in after):
            yield source.problem((*here, "start"), "needs a block or rating before it; there is nothing learned yet")


def _by_lot(random: np.random.Generator, setup: str, corners: Sequence[str] | None) -> Weights:
    if corners:  # evenly over the triangle
        return in_triangle(dict(zip(corners, random.dirichlet(np.ones(len(corners))).tolist(), strict=True)), corners)
    controls = controls_of(setup)
    chosen = random.choice(len(controls), size=STARTED_RANDOMLY, replace=False)
    ends = [controls[int(k)] for k in chosen]
    return {end[int(random.integers(len(end)))]: round(0.05 * int(random.integers(6, 21)), 2) for end in ends}


class TuningStep(LiveStep):
    """begins: the weights that it starts with, where they are known before the session."""

    kind: Literal["tuning"]
    start: Literal["neutral", "learned", "random"]
    begins: Weights = {}


class Tuning(LiveKind[TuningStep, LiveAnswer]):
    name = "tuning"
    step = TuningStep
    answers = LiveAnswer
    besides = AboutLive
    stages = {"tuning": TuningStage}
    stored = {
        "weights": "objective -> weight from 0 to 1 at the end; what is not named weighs nothing",
        "start": "the same in the beginning",
        "history": "every change in order: seconds since the page was opened, place, by (mouse, touch, pen, keys, "
        "headset, button, words or bot), objective, weight; also as the table tuning_changes",
        **STORED_IN_ROOM,
    }

    def payload(self, step: TuningStep, page: Page) -> dict[str, Any]:
        stage = page.stage_of(step, TuningStage)
        asked = local(stage.question, page.language) if stage is not None and stage.question else None
        return super().payload(step, page) | {"question": asked, "start": step.begins}

    def payload_now(self, step: TuningStep, moment: Moment) -> dict[str, Any]:
        return {"start": find_arrival_notes(moment, step, BEGAN).get("start", step.begins)}

    def arrive(self, step: TuningStep, acting: Acting) -> None:
        start = step.begins
        if step.start == "learned":
            found = find_belief(acting.s, acting.files, acting.session)
            start = startable(step, found.weights if found is not None else {})
        log_event(acting.s, BEGAN, session_id=acting.session.id, step=step.key, start=start)

    def keep(self, step: TuningStep, acting: Acting, stored: dict[str, Any]) -> dict[str, Any]:
        start = find_arrival_notes(acting, step, BEGAN).get("start", step.begins)
        check_history(start, stored)
        return {"start": start}

    def tell_simulated(self, step: TuningStep, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        return {"start": payload["start"], "objectives": step.objectives, "named": step.named}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        wanted = simulate_weights(step, participant) or (step["start"] if step.get("objectives") else {})
        return {"weights": wanted, "history": slide(step["start"], wanted)}


KIND = Tuning()
