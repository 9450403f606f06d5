"""What every kind of step is made of besides its stage and steps (`steps.py`): its page, and what it does in a session.

A kind's own file in `kinds` fills these in and ends with `KIND = ...`; it is found there, or by an entry point of
`desirepath.kinds` in another package, so that whoever adds one touches no list. Nothing here, and nothing in the
session machine, knows a kind by name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cache, reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Generic, Literal, Protocol, TypeVar

import numpy as np
from pydantic import Field, TypeAdapter
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.grammar.when import Earlier, When
from desirepath.registries import Registry
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.models import Response, Session, Trial
from desirepath.store.sides import Side
from desirepath.study.clock import elapsed_s
from desirepath.study.frozen import Frozen
from desirepath.study.refusals import Refused
from desirepath.study.steps import BlockPart, Stage, Step, T
from desirepath.study.wire import Answer, Besides, Confirmed, Progress, TrialState

if TYPE_CHECKING:
    from desirepath.explain.shown_explanation import ShownExplanation
    from desirepath.report.simulated_cohorts import SimulatedPerson
    from desirepath.simulation.trajectory import Trajectory

S = TypeVar("S", bound=Step)
A = TypeVar("A", bound=Answer)

# ---- in a session ----------------------------------------------------------------------------------------------------


@dataclass
class Page:
    """What a step's texts are made from. earlier: answers by which items are left out; None: none is."""

    frozen: Frozen
    language: str
    completion_code: str | None = None
    earlier: Earlier | None = None

    def show_text(self, text: str) -> dict[str, Any]:
        """Title and text of a markdown file, as pages are given them."""
        title, body = self.frozen.text(text, self.language)
        return {"title": title, "text": body}

    def stage_of(self, step: Step, stage: type[T]) -> T | None:
        """The stage that planned the step, None where it is none of that class."""
        own = next((candidate for key, candidate in self.frozen.protocol.keyed_stages if key == step.stage), None)
        return own if isinstance(own, stage) else None


@dataclass
class Moment:
    """A session at this moment, inside a transaction. frozen: the protocol it runs on."""

    s: DatabaseSession
    session: Session
    frozen: Frozen
    now: datetime

    @property
    def stood_s(self) -> float | None:
        """Seconds since the step was reached, reloads and pauses included; None where the clock was set back."""
        return elapsed_s(self.session.step_since or self.now, self.now)

    @property
    def plan(self) -> list[Step]:
        """The participant's plan; it never changes, so it is read once in a transaction."""
        known: dict[str, list[Step]] = self.s.info.setdefault("plans", {})
        if self.session.id not in known:
            known[self.session.id] = read_plan(self.session.plan)
        return known[self.session.id]

    @property
    def step(self) -> Step:
        return self.plan[self.session.position]

    def answer_to(self, questionnaire: str) -> Mapping[str, Any] | None:
        """The participant's newest answers to that questionnaire, in whichever appointment; None: not answered."""
        keys = [step.key for step in self.plan if getattr(step, "questionnaire", None) == questionnaire]
        rows = (
            select(Response.value)
            .join(Session, Session.id == Response.session_id)
            .where(Session.participant_id == self.session.participant_id, Response.step_key.in_(keys))
            .order_by(Response.created_at.desc())
        )
        return self.s.scalars(rows).first()

    def is_asked(self, step: Step) -> bool:
        """Whether this person is asked that step, now that they come to it."""
        return (step.when is None or self._is_met(step.when)) and kind_of(step).is_asked(step, self)

    def may_come(self, step: Step) -> bool:
        """Whether a later step counts as ahead: not what an answer has ruled out, or what its kind does not count."""
        ruled_out = step.when and self.answer_to(step.when.questionnaire) is not None and not self._is_met(step.when)
        return not ruled_out and kind_of(step).may_come(step, self)

    def first_asked(self, index: int) -> int:
        """The index of the first step from there on that this person is asked."""
        while not self.is_asked(self.plan[index]):
            index += 1
        return index

    def _is_met(self, when: When) -> bool:
        return when.fits((self.answer_to(when.questionnaire) or {}).get(when.item))

    def query_shown(self, step_key: str) -> str | None:
        """The query of a step's trial, None where there is no trial or it is of none."""
        known: dict[tuple[str, str], Trial] = self.s.info.get("trials", {})  # of `session/view.py`
        if (self.session.id, step_key) in known:
            return known[self.session.id, step_key].query_id
        rows = select(Trial.query_id).where(Trial.session_id == self.session.id, Trial.step_key == step_key)
        return self.s.scalars(rows).first()

    def trial(self, step_key: str) -> Trial:
        """The trial that was made for that step."""
        rows = select(Trial).where(Trial.session_id == self.session.id, Trial.step_key == step_key)
        return self.s.scalars(rows).one()

    def has_trial(self, step_key: str) -> bool:
        """Whether a trial was made for that step."""
        rows = select(Trial.id).where(Trial.session_id == self.session.id, Trial.step_key == step_key)
        return self.s.scalars(rows).first() is not None

    def refusal(self, code: str, message: str, *, status: int = 409, **details: Any) -> Refused:
        """A refusal that names the session."""
        return Refused(status, code, message, session_id=self.session.id, study_id=self.session.study_id, **details)


def seconds_left(of: int, moment: Moment) -> float:
    """How many of so many seconds at the current step are left; all where the clock was set back."""
    return round(max(0.0, of - (moment.stood_s or 0.0)), 1)


@dataclass
class Acting(Moment):
    """The same, while it is being changed: the session is locked."""

    files: ArtefactStore

    def arrive(self) -> Ending | None:
        """What coming to the current step means, and whether that ends the session."""
        return kind_of(self.step).arrive(self.step, self)


@dataclass(frozen=True)
class Ending:
    """How coming to a step ends the session, by an event of `session/states.py`'s table. completion_code: the
    protocol's, `random` for one of the session's own; None: there is none. logged: beside the event, for the log.
    """

    event: Literal["complete", "end_appointment"]
    completion_code: str | None = None
    logged: Mapping[str, Any] = field(default_factory=dict)


class Simulated(Protocol):
    """What a simulated participant is made of, as kinds use it (`simulated/participant.py`)."""

    @property
    def random(self) -> np.random.Generator: ...
    @property
    def person(self) -> SimulatedPerson | None: ...

    def watch(self, step: Mapping[str, Any], sides: str) -> tuple[Trajectory, Trajectory]:
        """Watch the trial's trajectories, `ab` or `a`, and return both."""
        ...

    def choose(self, step: Mapping[str, Any], a: Trajectory, b: Trajectory) -> Side: ...
    def grade(
        self, step: Mapping[str, Any], a: Trajectory, b: Trajectory, *, no_difference: bool, degrees: bool
    ) -> dict[str, Any]:
        """The choice and how clear it is, or that there is no difference, as far as that is asked."""
        ...

    def opinion(self, step: Mapping[str, Any], trajectory: Trajectory) -> float:
        """How much one trajectory is liked, 0 to 1."""
        ...

    def judge_several(self, step: Mapping[str, Any]) -> list[float]:
        """How much each of the trial's several trajectories seems worth."""
        ...

    def mark(self, step: Mapping[str, Any], *, good: bool) -> list[dict[str, Any]]:
        """Watch the trial's trajectory and return the moments that it marks; good: also such as it likes."""
        ...

    def draw(self, step: Mapping[str, Any]) -> dict[str, Any]: ...
    def choose_weights(self, step: Mapping[str, Any]) -> dict[str, float]:
        """The preference weights that it would set: objective -> weight above 0."""
        ...


def has_timed_out(value: Mapping[str, Any]) -> bool:
    """Whether the page says that the protocol's time for the step was over."""
    return value.get("timed_out") is True


class Kind(Generic[S, A]):
    """One kind of step. What is left as it is here is right for a page that is read and confirmed."""

    name: ClassVar[str]
    step: ClassVar[type[Step]]
    stages: ClassVar[Mapping[str, type[Stage]]] = {}
    """Keys under the protocol's `stages` that plan steps of this kind (others, too, may)."""
    block_parts: ClassVar[Mapping[str, type[BlockPart]]] = {}
    """Keys in a block's `before`, `after` and `between`."""
    shows: ClassVar[Literal["page", "trajectories", "paper", "live"]] = "page"
    """trajectories: a trial on the stage; paper: something is drawn there; live: what a robot would do, redrawn."""
    trajectories: ClassVar[int] = 2
    """How many a trial of it shows at most, one after the other."""
    says_while_shown: ClassVar[bool] = False
    """What is said of a trajectory is said while it plays, and known to that page alone until it is sent."""
    previewed: ClassVar[bool] = False
    """A protocol's preview shows an example query on the stage."""
    consents: ClassVar[bool] = False
    """Its answer is what the answers after it are given under."""
    ends_appointment: ClassVar[bool] = False
    """The plan's steps after it belong to the next appointment."""
    goes_on: ClassVar[bool] = False
    """Nobody answers it: the session goes on by itself (`settle`), and its progress does not count it."""
    answer: ClassVar[str] = ""
    """What its stored answers are called, as `responses.kind`; default its name."""
    answers: ClassVar[type[Answer]] = Confirmed
    """What is sent as its answer; the published contract and the page's types follow it."""
    progress: ClassVar[type[Progress] | None] = None
    """What `state` tells; trials' is `TrialState`."""
    besides: ClassVar[type[Besides]] = Besides
    """What `tell_simulated` says to simulated participants."""
    stored: ClassVar[Mapping[str, str]] = {}
    """What a stored answer holds (`responses.value` in the export): field -> its meaning."""
    begun: ClassVar[Mapping[str, Callable[[Acting], None]]] = {}
    """What happens when a step whose `then` says so was answered."""

    @property
    def response_kind(self) -> str:
        return self.answer or self.name

    @property
    def progress_model(self) -> type[Progress] | None:
        """What its trial or drawing tells on the wire."""
        return TrialState if self.shows == "trajectories" else self.progress

    # what its page is given

    def payload(self, step: S, page: Page) -> dict[str, Any]:
        """What the template is given: texts in the participant's language, never which trajectory is whose."""
        return {}

    def payload_now(self, step: S, moment: Moment) -> dict[str, Any]:
        """What of that only a running session knows."""
        return {}

    def state(self, step: S, moment: Moment) -> dict[str, Any] | None:
        """How far its trial or drawing is, as `progress` says; trials' own is `session/view.py`'s."""
        return None

    def explains(self, step: S, moment: Moment) -> ShownExplanation | None:
        """What of the policy's reasons its stage shows beside the trajectory; None: nothing."""
        return None

    # whether somebody meets it

    def is_asked(self, step: S, moment: Moment) -> bool:
        """Whether this person is asked, now that they come to it."""
        return True

    def may_come(self, step: S, moment: Moment) -> bool:
        """Whether a later step counts as ahead, for the progress."""
        return True

    def pass_over(self, step: S, index: int, acting: Acting) -> int:
        """Index of the step to go on with instead of this one at `index`; the same where it is asked."""
        return index

    def interrupt(self, step: S, s: DatabaseSession, session: Session, reason: str) -> bool | None:
        """What was being shown at it was not seen to its end: whether that changed anything. None: what is shown is a
        trial, whose rule is the session's own (`session/watching.py`).
        """
        return None

    # arriving, answering, leaving

    def arrive(self, step: S, acting: Acting) -> Ending | None:
        """What happens when the session comes to it, and whether that ends it."""
        return None

    def settle(self, step: S, acting: Acting) -> int | None:
        """Index of the step to go on with by itself; None: not yet, or never."""
        return None

    def waits(self, step: S, moment: Moment) -> bool:
        """Whether `settle` would find nothing to go on with yet."""
        return True

    def check_time(self, step: S, moment: Moment, value: Mapping[str, Any]) -> None:
        """Raise Refused for a step that nobody answers."""

    def check(self, step: S, answer: A, page: Page) -> dict[str, Any]:
        """The answer to store. Raises BadValue for what its model lets through. Default: read, nothing to answer."""
        return {}

    def keep(self, step: S, acting: Acting, stored: dict[str, Any]) -> dict[str, Any]:
        """What storing the answer means beside the row; returns what the row holds besides."""
        return {}

    def ends(self, step: S, moment: Moment, stored: Mapping[str, Any]) -> str | None:
        """Why the study ends for somebody with that answer."""
        return None

    # simulated participants

    def tell_simulated(self, step: S, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        """What a simulated participant is told beside what pages show, as `besides` says; nobody else is."""
        return {}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        """A simulated participant's answer. step: as the API tells it, with what `tell_simulated` adds."""
        return {}


# ---- all that there are ----------------------------------------------------------------------------------------------

KINDS: Registry[Kind[Any, Any]] = Registry("desirepath.kinds", "desirepath.study.kinds", "KIND")
"""name -> kind."""


def kind_of(step: Step) -> Kind[Any, Any]:
    """The kind of a step."""
    return KINDS[step.kind]


def begin(then: str, acting: Acting) -> None:
    """What the answer to a step begins that says so."""
    for kind in KINDS.values():
        if then in kind.begun:
            kind.begun[then](acting)


@cache
def _readers() -> tuple[TypeAdapter[Step], TypeAdapter[list[Step]]]:
    """Of one step, and of a plan: the union of what the kinds plan."""
    any_step: Any = Annotated[reduce(or_, (kind.step for kind in KINDS.values())), Field(discriminator="kind")]
    return TypeAdapter(any_step), TypeAdapter(list[any_step])


def read_step(stored: Mapping[str, Any]) -> Step:
    """A step as plans hold it."""
    return _readers()[0].validate_python(stored)


def read_plan(stored: Sequence[Mapping[str, Any]]) -> list[Step]:
    """A whole plan, likewise."""
    return _readers()[1].validate_python(stored)


def dump_plan(plan: Iterable[Step]) -> list[dict[str, Any]]:
    """A plan as sessions hold it."""
    return [step.as_stored() for step in plan]


@cache
def stage_kinds() -> Mapping[str, type[Stage]]:
    """Key in the protocol's `stages` -> what it may say."""
    return {name: stage for kind in KINDS.values() for name, stage in kind.stages.items()}


@cache
def block_parts() -> Mapping[str, type[BlockPart]]:
    """Key in a block's `before`, `after` and `between` -> what it may say."""
    return {name: part for kind in KINDS.values() for name, part in kind.block_parts.items()}


def make_trial(acting: Acting, step: Step, *, kind: str, trajectory_a: str, trajectory_b: str, **rest: Any) -> Trial:
    """The trial of the step that the session has come to."""
    trial = Trial(
        session_id=acting.session.id,
        step_key=step.key,
        index=acting.session.position,
        kind=kind,
        view=step.view,
        trajectory_a=trajectory_a,
        trajectory_b=trajectory_b,
        phase_since=acting.now,
        **rest,
    )
    acting.s.add(trial)
    acting.s.flush()
    return trial
