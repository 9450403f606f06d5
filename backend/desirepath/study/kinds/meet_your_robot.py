"""Kind of step `meet_your_robot`: after everything blind, who taught a robot is told what was learned, sees it beside
the usual one, says whether that is them, and corrects it by hand.

Nothing of it is a trial or a choice, so nothing of it reaches the blind data.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from desirepath.grammar.parts import an_example
from desirepath.grammar.source import Path, Problem, Source
from desirepath.learning.policies.reason_codes import TOLD, Did
from desirepath.simulation.setup_parts import PLACES
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.events import log_event
from desirepath.store.job_results import Learned
from desirepath.store.models import Artefact
from desirepath.study.kind import Acting, Moment, Page, Simulated
from desirepath.study.kinds.appointment import AppointmentStage
from desirepath.study.kinds.comparison import ComparisonStage
from desirepath.study.kinds.evaluation import EvaluationStage
from desirepath.study.kinds.live import (
    AboutLive,
    LiveAnswer,
    LiveKind,
    LiveStage,
    LiveStep,
    Weights,
    check_history,
    crowd_setups,
    distance,
    find_arrival_notes,
    simulate_weights,
    slide,
    startable,
)
from desirepath.study.kinds.questionnaire import within
from desirepath.study.kinds.wait import EACH_SCENE, TrainStage
from desirepath.study.personalising.about_person import was_preferred
from desirepath.study.personalising.alignment_jobs import ready_job
from desirepath.study.personalising.believed import find_belief
from desirepath.study.personalising.live_rollouts import condition_on, driving, shipped_base
from desirepath.study.steps import Pace, Planning, Stage
from desirepath.study.wire import STORED_IN_ROOM, WholeNumber

if TYPE_CHECKING:
    from desirepath.learning.policies.policy import DrivingPolicy
    from desirepath.learning.policies.reason_codes import Reason
    from desirepath.simulation.trajectory import Trajectory

TAKES_S = 150.0  # ours
POINTS = 5
BEGAN = "met_robot"


class MeetYourRobotStage(LiveStage, Stage):
    """After the blind comparison: what was learned and how sure it is, in plain words; own and usual robot in the same
    scenes, and why the own one drove otherwise where it is chosen per scene; whether that is them; the weights to
    correct it. Passed over where no own robot was shown: the debriefing says why. reasons: what each robot looks at on
    its way is said, too. preferred: in how many of the comparison's `scenes` with base the own robot must have been
    chosen; who chose it less often does not come here.
    """

    model_config = an_example({"setup": "study_room", "scenes": 3})

    reasons: bool = False
    preferred: int | None = Field(None, ge=1, le=10, description="default: whatever was chosen")

    once = True
    for_everybody = True

    def plan(self, at: Planning) -> list[MeetYourRobotStep]:  # type: ignore[override]  # a list of steps
        own = {"kind": "meet_your_robot", "key": at.key, "stage": at.key}
        asked = {"reasons": self.reasons, "preferred": self.preferred or 0}
        return [MeetYourRobotStep.model_validate(own | self.step_fields | asked)]

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        return TAKES_S

    def problems(self, here: Path, stages: Sequence[Stage], source: Source) -> Iterator[Problem]:
        mine = [stage is self for stage in stages].index(True)
        before, after = stages[:mine], stages[mine + 1 :]
        compared = [k for k, one in enumerate(before) if isinstance(one, ComparisonStage)]
        if not compared:
            yield source.problem(here, "needs the comparison before it: it shows whose robot was whose")
        elif any(isinstance(stage, AppointmentStage) for stage in before[compared[0] :]):
            yield source.problem(here, "must stand in the comparison's appointment, whose robot it shows")
        chooses = any(isinstance(stage, TrainStage) and stage.recipe == EACH_SCENE for stage in before)
        if self.preferred is None and chooses:
            told = "recipe each_scene needs `preferred` of meet_your_robot: nothing else tells that the robot is better"
            yield source.problem((*here, "preferred"), told)
        if self.preferred is not None and compared:
            against = before[compared[0]]
            assert isinstance(against, ComparisonStage)  # noqa: S101  looked for above
            with_base = against.scenes if "base" in against.arms else 0
            if self.preferred > with_base:
                message = f"must be at most the comparison's scenes with base, {with_base}"
                yield source.problem((*here, "preferred"), message)
        if any(stage.teaches or isinstance(stage, ComparisonStage | EvaluationStage) for stage in after):
            yield source.problem(here, "stands before something blind; put it after blocks, ratings and comparisons")
        if self.reasons and self.setup in crowd_setups():
            yield source.problem((*here, "reasons"), f"cannot be said in {self.setup}, where more than one person is")
        if any(isinstance(stage, TrainStage) and stage.job != "align" for stage in before):
            yield source.problem(here, "needs a train stage with job align: what is learned from paths has no weights")


class MeetYourRobotStep(LiveStep):
    """preferred: how often the own robot must have been chosen beside the usual one; 0: nobody asks."""

    kind: Literal["meet_your_robot"]
    preferred: int = 0


class ToldWhy(BaseModel):
    """What stood there once both had driven. place: in which scene, from 0."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    place: int = Field(ge=0, lt=PLACES)
    did: list[Did] = Field(max_length=TOLD)


class MetAnswer(LiveAnswer):
    """agreement: is that you? 1 not at all, 5 exactly. weights: as the controls stand in the end. why: what was said of
    the own robot's choice, each place once."""

    agreement: WholeNumber = Field(description=f"1 to {POINTS}")
    why: list[ToldWhy] = Field([], max_length=PLACES)


class AboutMeeting(AboutLive):
    learned: Weights | None = Field(None, description="what was learned")


class MeetYourRobot(LiveKind[MeetYourRobotStep, MetAnswer]):
    name = "meet_your_robot"
    step = MeetYourRobotStep
    answers = MetAnswer
    besides = AboutMeeting
    stages = {"meet_your_robot": MeetYourRobotStage}
    stored = {
        "agreement": "whether that is them: 1 not at all, 5 exactly",
        "learned": "objective -> weight: what their answers taught; of a robot that goes by no weights "
        "what comes closest",
        "statement": "what they were told of their preference: rather (the first of two objectives rather than "
        "the other), beyond (something that is none of the nine); null: none, as nothing was predicted well enough",
        "sure": "probability of what they were told, as it stood there; null: none",
        "something_else": "probability that their answers are about none of the nine objectives, where they "
        "were told so; else null",
        "why": "what was said of the own robot's choice, once both had driven: [{place, did}], place from 0; did: "
        "as_usual, or what it did otherwise than the usual one and their answers speak for (farther, slower_near, ...)",
        "corrected": "whether any weight was changed",
        "start": "the weights that the controls began with: the learned ones",
        "weights": "the weights at the end",
        "distance": "Euclidean, from learned to corrected weights; 0: not corrected",
        "history": "every change in order, as of `tuning`; also as the table tuning_changes",
        **STORED_IN_ROOM,
    }

    def robots_in(self, step: MeetYourRobotStep) -> Literal[1, 2]:
        return 2

    def policies(
        self, step: MeetYourRobotStep, moment: Moment, files: ArtefactStore, weights: Mapping[str, float] | None
    ) -> Sequence[DrivingPolicy]:
        """The own robot as it was compared, or as the controls stand; then the usual one."""
        base = shipped_base(step.setup)
        if weights is not None:
            return [condition_on(step.setup, weights), base]
        own = _own(moment)
        if own is not None and own.quarantined_at is None:
            return [driving(files, own.id), base]
        # None was made, or it went with somebody's erased answers: what their own ones taught, as the controls begin.
        return [condition_on(step.setup, find_arrival_notes(moment, step, BEGAN).get("start", {})), base]

    def why(self, policies: Sequence[DrivingPolicy], trajectories: Sequence[Trajectory]) -> list[Reason]:
        from desirepath.learning.policies.choice_reasons import reasons_in_scene
        from desirepath.learning.policies.choosing import ChoosingPolicy

        own, usual = trajectories
        return reasons_in_scene(policies[0], own, usual) if isinstance(policies[0], ChoosingPolicy) else []

    def payload(self, step: MeetYourRobotStep, page: Page) -> dict[str, Any]:
        return super().payload(step, page) | {
            "start": startable(step, {}),
            "believed": None,
            "points": POINTS,
            "reasons": step.reasons,
        }

    def payload_now(self, step: MeetYourRobotStep, moment: Moment) -> dict[str, Any]:
        noted = find_arrival_notes(moment, step, BEGAN)
        return {name: noted[name] for name in ("start", "believed") if name in noted}

    def is_asked(self, step: MeetYourRobotStep, moment: Moment) -> bool:
        shown = moment.session.personalisation == "shown" and not _is_gone(moment)
        return shown and (not step.preferred or was_preferred(moment.s, moment.session, step.preferred))

    def may_come(self, step: MeetYourRobotStep, moment: Moment) -> bool:
        return moment.session.personalisation in (None, "shown") and not _is_gone(moment)

    def arrive(self, step: MeetYourRobotStep, acting: Acting) -> None:
        found = find_belief(acting.s, acting.files, acting.session, ready_job(acting.s, acting.session))
        start = startable(step, found.weights if found is not None else {})
        believed = found.as_dict() if found is not None else None
        notes: dict[str, Any] = {"step": step.key, "believed": believed, "start": start}
        log_event(acting.s, BEGAN, session_id=acting.session.id, **notes)

    def check(self, step: MeetYourRobotStep, answer: MetAnswer, page: Page) -> dict[str, Any]:
        return super().check(step, answer, page) | {
            "agreement": within("value.agreement", answer.agreement, 1, POINTS),
            "why": [told.model_dump(mode="json") for told in answer.why],
        }

    def keep(self, step: MeetYourRobotStep, acting: Acting, stored: dict[str, Any]) -> dict[str, Any]:
        noted = find_arrival_notes(acting, step, BEGAN)
        start, believed = noted.get("start", {}), noted.get("believed") or {}
        check_history(start, stored)
        learned, statement = believed.get("weights", {}), believed.get("statement")
        corrected = bool(stored["history"]) and distance(start, stored["weights"]) > 0
        apart = distance(startable(step, learned), stored["weights"]) if corrected else 0.0
        return {
            "learned": learned,
            "statement": statement,
            "sure": believed.get("rather_sure") if statement == "rather" else None,
            "something_else": (believed.get("beyond") or {}).get("sure") if statement == "beyond" else None,
            "start": start,
            "corrected": corrected,
            "distance": apart,
        }

    def tell_simulated(self, step: MeetYourRobotStep, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        learned = (payload["believed"] or {}).get("weights", {})
        known = {"start": payload["start"], "objectives": step.objectives, "named": step.named}
        return known | {"learned": startable(step, learned)}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        """Who is not met well corrects it."""
        own = simulate_weights(step, participant)
        apart = distance(step["learned"], own)
        agreement = max(1, POINTS - round(4 * min(apart, 1.0)))
        if agreement == POINTS or not own:
            return {"agreement": agreement, "weights": step["start"], "history": []}
        return {"agreement": agreement, "weights": own, "history": slide(step["start"], own)}


def _own(moment: Moment) -> Artefact | None:
    """The policy that was compared as theirs, None where there was none."""
    job = ready_job(moment.s, moment.session)
    learned = job.result_as(Learned) if job is not None else None
    return moment.s.get(Artefact, learned.policy) if learned is not None else None


def _is_gone(moment: Moment) -> bool:
    """Whether it held answers of somebody who was erased."""
    own = _own(moment)
    return own is not None and own.quarantined_at is not None


KIND = MeetYourRobot()
