"""What every kind of step is made of: its stage in the protocol, its step in the plan, and what it does in a session.

A kind's own file fills these in and ends with `KIND = ...`; `kinds/__init__.py` finds it there. Nothing here, and
nothing in the session machine, knows a kind by name. Kinds know no protocol as a whole: they are handed what they need.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, Protocol, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.grammar.conditions import Condition, Ordered
from desirepath.grammar.parts import Part
from desirepath.grammar.skipping import Earlier, When
from desirepath.grammar.source import Path, Problem, Source
from desirepath.grammar.words import View
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.models import Response, Session, Trial
from desirepath.store.sides import Side
from desirepath.study.clock import elapsed_s
from desirepath.study.kinds.wire import Answer, Besides, Confirmed, Progress, TrialState
from desirepath.study.plan.asked_queries import DrawnQueries, Needs
from desirepath.study.refusals import Refused

if TYPE_CHECKING:
    from desirepath.explain.shown_explanation import ShownExplanation
    from desirepath.report.made_up_cohorts import MadeUpPerson
    from desirepath.simulation.trajectory import Trajectory
    from desirepath.study.protocol.freezing import FrozenProtocol

PAGE_S = 30.0  # ours: how long a page is read

# ---- in the protocol -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Pace:
    """What people take, seconds: a page; a trial of two trajectories, letters and choice; one trajectory alone."""

    page_s: float
    trial_s: float
    single_s: float


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
        return [one for one in self.stages if isinstance(one, stage)]


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
        conditions = [one for group in groups for one in self.conditions(group)]  # type: ignore[attr-defined]
        return {view for view in (own, *(one.view for one in conditions)) if view is not None}

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
        """How long it takes, breaks included."""
        return pace.page_s

    def numbers(self) -> dict[str, int]:
        """What it adds to the numbers that texts may name in braces (`protocol/numbers_in_texts.py`); `pairs_per_block`
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
    when: When | None = None
    then: Literal["train", "train_again"] | None = None
    rates: str | None = None

    def least_s(self, *, timed_out: bool) -> int:
        """How long its page must stand before it can be answered. timed_out: half filled, because its time is over."""
        return 0

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


S = TypeVar("S", bound=Step)
A = TypeVar("A", bound=Answer)

# ---- in a session ----------------------------------------------------------------------------------------------------


@dataclass
class Page:
    """What a step's texts are made from. earlier: answers by which items are left out; None: none is."""

    frozen: FrozenProtocol
    language: str
    completion_code: str | None = None
    earlier: Earlier | None = None

    def titled(self, text: str) -> dict[str, Any]:
        """Title and text of a markdown file, as pages are given them."""
        title, body = self.frozen.text(text, self.language)
        return {"title": title, "text": body}


@dataclass
class Moment:
    """A session at this moment, inside a transaction. frozen: the protocol it runs on."""

    s: DatabaseSession
    session: Session
    frozen: FrozenProtocol
    now: datetime

    @property
    def stood_s(self) -> float | None:
        """Seconds since the step was reached, reloads and pauses included; None where the clock was set back."""
        return elapsed_s(self.session.step_since or self.now, self.now)

    @property
    def plan(self) -> list[Step]:
        """The participant's plan; it never changes, so it is read once in a transaction."""
        from desirepath.study.kinds import read_plan  # the kinds are found after this file is read

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
        given = (
            select(Response.value)
            .join(Session, Session.id == Response.session_id)
            .where(Session.participant_id == self.session.participant_id, Response.step_key.in_(keys))
            .order_by(Response.created_at.desc())
        )
        return self.s.scalars(given).first()

    def is_asked(self, step: Step) -> bool:
        """Whether this person is asked that step, now that they come to it."""
        from desirepath.study.kinds import kind_of

        return (step.when is None or self._is_met(step.when)) and kind_of(step).is_asked(step, self)

    def may_come(self, step: Step) -> bool:
        """Whether a later step counts as ahead: not what an answer has ruled out, or what its kind does not count."""
        from desirepath.study.kinds import kind_of

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
        found = select(Trial.query_id).where(Trial.session_id == self.session.id, Trial.step_key == step_key)
        return self.s.scalars(found).first()

    def has_trial(self, step_key: str) -> bool:
        """Whether a trial was made for that step."""
        found = select(Trial.id).where(Trial.session_id == self.session.id, Trial.step_key == step_key)
        return self.s.scalars(found).first() is not None

    def refused(self, code: str, message: str, *, status: int = 409, **details: Any) -> Refused:
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
        from desirepath.study.kinds import kind_of

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
    def person(self) -> MadeUpPerson | None: ...

    def watch(self, step: Mapping[str, Any], sides: str) -> tuple[Trajectory, Trajectory]:
        """Watch the trial's trajectories, `ab` or `a`, and return both."""
        ...

    def choose(self, step: Mapping[str, Any], a: Trajectory, b: Trajectory) -> Side: ...
    def opinion(self, step: Mapping[str, Any], trajectory: Trajectory) -> float:
        """How much one trajectory is liked, 0 to 1."""
        ...

    def draw(self, step: Mapping[str, Any]) -> dict[str, Any]: ...
    def preferred_weights(self, step: Mapping[str, Any]) -> dict[str, float]:
        """The preference weights that it would set: objective -> weight above 0."""
        ...


def timed_out(value: Mapping[str, Any]) -> bool:
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
    """How many a trial of it shows, one after the other."""
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
    """What `known_to_simulated` says to simulated participants."""
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

    def passed_over(self, step: S, index: int, acting: Acting) -> int:
        """Index of the step to go on with instead of this one at `index`; the same where it is asked."""
        return index

    def interrupted(self, step: S, s: DatabaseSession, session: Session, reason: str) -> bool | None:
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

    def known_to_simulated(self, step: S, moment: Moment, payload: Mapping[str, Any]) -> dict[str, Any]:
        """What a simulated participant is told beside what pages show, as `besides` says; nobody else is."""
        return {}

    def simulate(self, step: Mapping[str, Any], participant: Simulated) -> dict[str, Any]:
        """A simulated participant's answer. step: as the API tells it, with what `known_to_simulated` adds."""
        return {}


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
