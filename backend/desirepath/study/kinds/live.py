"""What steps share at which weights are changed by hand and the robot's way is redrawn at once. No kind by itself.

The rollouts are `personalising/live_rollouts.py`'s; the requests for them `web/participant/live_requests.py`'s.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, field_validator
from sqlalchemy import select

from desirepath.grammar.parts import Localized, OneOf, Part
from desirepath.grammar.source import Path
from desirepath.grammar.words import View
from desirepath.simulation.setup_parts import PLACES
from desirepath.simulation.setups import preference_setups, setups_with
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.models import Event
from desirepath.study.kind import Kind, Moment, Page, Simulated
from desirepath.study.personalising.live_rollouts import condition_on, scenes_of, typical_rollouts
from desirepath.study.steps import Pace, Stage, Step
from desirepath.study.wire import Answer, BadValue, Besides, InRoomAnswer

if TYPE_CHECKING:
    from desirepath.learning.policies.policy import DrivingPolicy
    from desirepath.learning.policies.reason_codes import Reason
    from desirepath.simulation.scene import Scene
    from desirepath.simulation.trajectory import Trajectory

TAKES_S = 120.0  # ours
MOST_CHANGES = 2_400  # ours: so many fit a request; the page forgets the oldest from 2,300 on
LONGEST_S = 24 * 3600.0
ROUNDED = 3  # digits of a stored weight; sliders have two
SAME = 0.0051  # weights that differ by less are the same: half a step of a slider
CONTROLS: tuple[tuple[str, ...], ...] = (
    ("closer", "farther"),
    ("person_on_left", "person_on_right"),
    ("clearance",),
    ("slower_near_person",),
    ("smoother",),
    ("shorter",),
    ("faster",),
)
"""The sliders: nine weights, of which two pairs exclude each other, so that each pair is the two ends of one slider."""
CROWD_CONTROLS: tuple[tuple[str, ...], ...] = (
    ("closer", "farther"),
    ("passes_behind",),
    ("waits",),
    ("slower_near_person",),
    ("smoother",),
    ("faster",),
)
"""The same among people who walk, without the two that the shipped policy does not follow (experiments/notebook): a
slider that does nothing, or the wrong thing, is no control."""
OBJECTIVES = tuple(name for control in CONTROLS for name in control)
OPPOSITES = tuple(pair for pair in CONTROLS if len(pair) == 2)
PersonSetup = Annotated[str, OneOf(preference_setups)]
Setup = Annotated[str, OneOf(lambda: (*preference_setups(), *crowd_setups()))]
CORNERS = 3
Weights = dict[str, float]


def crowd_setups() -> tuple[str, ...]:
    """The setups with a conditioned policy in which people walk."""
    return tuple(name for name in setups_with("conditioned") if name not in preference_setups())


def controls_of(setup: str) -> tuple[tuple[str, ...], ...]:
    """The sliders of what people may set in that setup."""
    return CROWD_CONTROLS if setup in crowd_setups() else CONTROLS


def objectives_on(setup: str) -> tuple[str, ...]:
    """What its sliders say, in their order."""
    return tuple(name for control in controls_of(setup) for name in control)


def three_corners(names: list[str], objectives: Sequence[str] = OBJECTIVES) -> list[str]:
    """The same names. Raises ValueError unless they can be the corners of a triangle of these objectives."""
    known = ", ".join(objectives)
    for name in names:
        if name not in objectives:
            raise ValueError(f"{name[:40]!r} is no objective; known are {known}")
        if names.count(name) > 1:
            raise ValueError(f"names {name} twice; needed are three different objectives")
    if len(names) != CORNERS:
        raise ValueError(f"names {len(names)} objectives; a triangle has three corners, of {known}")
    for pair in OPPOSITES:
        if set(pair) <= set(names):
            raise ValueError(f"names {pair[0]} and {pair[1]}, of which only one may be above 0")
    return names


class LiveStage(Part):
    """Where weights are changed: in `scenes` scenes of `setup`, in which its conditioned policy drives. objectives:
    three of the setup's nine, weighed against each other in a triangle; None: all nine, by sliders.
    """

    setup: Setup = "study_room"
    scenes: int = Field(3, ge=1, le=PLACES)
    view: View = "top_down"
    objectives: list[str] | None = None

    @field_validator("objectives")
    @classmethod
    def _corners(cls, names: list[str] | None, info: ValidationInfo) -> list[str] | None:
        return names if names is None else three_corners(names, objectives_on(info.data.get("setup", "study_room")))

    @property
    def step_fields(self) -> dict[str, Any]:
        """What its step says of it."""
        own = {"setup": self.setup, "scenes": self.scenes, "view": self.view}
        return own | ({"objectives": self.objectives} if self.objectives else {})


class AskedLiveStage(LiveStage, Stage):
    """One that asks something by itself, with a question of the protocol's own where it has one."""

    asks: ClassVar[bool] = True

    question: Localized | None = None

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        return TAKES_S

    def local_texts(self) -> Iterator[tuple[dict[str, str], Path]]:
        if self.question is not None:
            yield self.question, ("question",)


class LiveStep(Step):
    """setup: whose conditioned policy drives; scenes: how many of the setup's places there are to try it in;
    objectives: the corners of the triangle, None: sliders for all; reasons: whether it is
    said what the robot looks at.
    """

    setup: str
    scenes: int
    view: View
    objectives: list[str] | None = None
    reasons: bool = False

    @property
    def named(self) -> tuple[str, ...]:
        """What its controls can say."""
        return objectives_on(self.setup)


def _numbers(given: object) -> object:
    """No booleans: to JSON's readers these are numbers, too."""
    if isinstance(given, dict) and any(isinstance(value, bool) for value in given.values()):
        raise ValueError("must be numbers from 0 to 1 by objective")
    return given


class Change(BaseModel):
    """One weight was changed. seconds: since the page was opened; place: in which scene, from 0; by: mouse, touch, pen,
    keys, headset or button; objective: which weight; weight: its new value.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    seconds: float = Field(ge=0, le=LONGEST_S, allow_inf_nan=False)
    place: int = Field(ge=0, lt=PLACES)
    by: Literal["mouse", "touch", "pen", "keys", "headset", "button", "words", "bot"]
    objective: str = Field(max_length=40)
    weight: float = Field(ge=0, le=1, allow_inf_nan=False)


class LiveAnswer(InRoomAnswer):
    """The weights that somebody arrived at, and every change on the way there, in order."""

    weights: Annotated[Weights, BeforeValidator(_numbers)]
    history: list[Change] = Field([], max_length=MOST_CHANGES)


class AboutLive(Besides):
    start: Weights | None = Field(None, description="the weights that the controls stand at in the beginning")
    objectives: list[str] | None = Field(None, description="those weighed in a triangle; null: all, by sliders")
    named: list[str] | None = Field(None, description="all that the controls can say")


def clean_weights(weights: Mapping[str, float], objectives: Sequence[str], field: str = "value.weights") -> Weights:
    """Those above 0, rounded, in these objectives' order. Raises BadValue for names, values or opposites that cannot
    be."""
    for name, weight in weights.items():
        if name not in objectives:
            raise BadValue(f"{field}.{name[:40]}", weight, f"is no objective; known are {', '.join(objectives)}")
        if not 0 <= weight <= 1:
            raise BadValue(f"{field}.{name}", weight, "must be from 0 to 1")
    kept = {name: round(float(weights[name]), ROUNDED) for name in objectives if weights.get(name, 0) > 0}
    for pair in OPPOSITES:
        if set(pair) <= set(kept):
            raise BadValue(f"{field}.{pair[1]}", kept[pair[1]], f"cannot be above 0 beside {pair[0]}, its opposite")
    return kept


def in_triangle(weights: Mapping[str, float], corners: Sequence[str]) -> Weights:
    """What those weights say of the corners alone, in whole percent; the middle where they say nothing."""
    shares = [max(0.0, weights.get(name, 0.0)) for name in corners]
    together = sum(shares)
    exact = [100 * share / together if together > 0 else 100 / len(corners) for share in shares]
    percent = [math.floor(share) for share in exact]
    missing = sorted(range(len(corners)), key=lambda k: percent[k] - exact[k])[: 100 - sum(percent)]
    whole = [share + (k in missing) for k, share in enumerate(percent)]
    return {name: share / 100 for name, share in zip(corners, whole, strict=True) if share > 0}


def startable(step: LiveStep, weights: Mapping[str, float]) -> Weights:
    """Those weights as the step's controls can stand at them."""
    if step.objectives:
        return in_triangle(weights, step.objectives)
    return {name: weight for name, weight in weights.items() if name in step.named}


def replay(start: Mapping[str, float], history: Iterable[Mapping[str, Any]]) -> Weights:
    """The weights after those changes; raising one of two opposites puts the other to 0."""
    now = dict(start)
    for change in history:
        now[change["objective"]] = change["weight"]
        for pair in OPPOSITES:
            if change["objective"] in pair and change["weight"] > 0:
                now[pair[1 - pair.index(change["objective"])]] = 0.0
    return {name: weight for name, weight in now.items() if weight > 0}


def distance(one: Mapping[str, float], other: Mapping[str, float]) -> float:
    """Euclidean distance of two weight vectors, 0 to 3 (ours)."""
    squares: float = sum((one.get(name, 0.0) - other.get(name, 0.0)) ** 2 for name in {*one, *other})
    return round(math.sqrt(squares), 4)


def find_arrival_notes(moment: Moment, step: Step, event: str) -> dict[str, Any]:
    """What was noted when the session came to that step; {} in previews and where nothing was."""
    noted = select(Event).where(Event.session_id == moment.session.id, Event.kind == event).order_by(Event.id.desc())
    return next(
        (dict(event_row.data) for event_row in moment.s.scalars(noted) if event_row.data.get("step") == step.key), {}
    )


S = TypeVar("S", bound=LiveStep)
A = TypeVar("A", bound=Answer)


class LiveKind(Kind[S, A]):
    """A kind whose page redraws the robot's way while weights are changed."""

    shows = "live"
    around_m: ClassVar[float] = 0.0
    """So much more of the floor is in sight from above, on each side."""

    def robots_in(self, step: S) -> Literal[1, 2]:
        """How many robots stand on its stage."""
        return 1

    def policies(
        self, step: S, moment: Moment, files: ArtefactStore, weights: Mapping[str, float] | None
    ) -> Sequence[DrivingPolicy]:
        """What drives each of them. weights: as the controls stand; None: as the step begins."""
        return [condition_on(step.setup, weights or {})]

    def why(self, policies: Sequence[DrivingPolicy], trajectories: Sequence[Trajectory]) -> list[Reason]:
        """Why the first robot drove otherwise than the second, where that is said."""
        return []

    def scene(self, step: S, place: int) -> tuple[Scene, tuple[Trajectory, ...]]:
        """What stands on its stage, and what the robot may do there, so that the view from above is wide enough."""
        scene = scenes_of(step.setup)[place]
        return scene, typical_rollouts(step.setup, place) if scene.room is None else ()

    def payload(self, step: S, page: Page) -> dict[str, Any]:
        shown = {"setup": step.setup, "scenes": step.scenes, "view": step.view, "controls": controls_of(step.setup)}
        return shown | {"triangle": step.objectives, "among_people": step.setup in crowd_setups()}

    def check(self, step: S, answer: A, page: Page) -> dict[str, Any]:
        assert isinstance(answer, LiveAnswer)  # noqa: S101  a kind with another answer checks it itself
        for number, change in enumerate(answer.history):
            if change.objective not in step.named:
                message = f"is no objective; known are {', '.join(step.named)}"
                raise BadValue(f"value.history.{number}.objective", change.objective, message)
        weights = clean_weights(answer.weights, step.named)
        if step.objectives:
            _require_triangle(weights, step.objectives)
        return {
            "weights": weights,
            "history": [change.model_dump(mode="json") for change in answer.history],
        }


def _require_triangle(weights: Weights, corners: Sequence[str]) -> None:
    for name, weight in weights.items():
        if name not in corners:
            raise BadValue(f"value.weights.{name}", weight, f"is no corner of the triangle: {', '.join(corners)}")
    together = sum(weights.values())
    if abs(together - 1) > 2 * SAME:
        raise BadValue("value.weights", round(together, ROUNDED), "must sum to 1, as in a triangle")


def check_history(start: Mapping[str, float], stored: Mapping[str, Any]) -> None:
    """Raise BadValue where the changes do not lead from the start to the final weights."""
    ends = replay(start, stored["history"])
    for name in {**ends, **stored["weights"]}:
        wanted = stored["weights"].get(name, 0.0)
        if abs(ends.get(name, 0.0) - wanted) > SAME:
            message = f"says {wanted:g}, but the changes in value.history lead to {ends.get(name, 0.0):g}"
            raise BadValue(f"value.weights.{name}", wanted, message)


def simulate_weights(step: Mapping[str, Any], participant: Simulated) -> Weights:
    """What a program would set with the controls of that step; {}: it has no preference that they know."""
    wanted = {name: w for name, w in participant.choose_weights(step).items() if name in step["named"]}
    return in_triangle(wanted, step["objectives"]) if wanted and step.get("objectives") else wanted


def slide(start: Mapping[str, float], to: Mapping[str, float]) -> list[dict[str, Any]]:
    """The changes of a program that moves one slider after the other, a second each."""
    moved = [name for name in {**start, **to} if abs(start.get(name, 0.0) - to.get(name, 0.0)) > SAME]
    moved.sort(key=lambda name: to.get(name, 0.0))  # first to 0 what is not wanted, so that no opposite is in the way
    return [
        {"seconds": float(number), "place": 0, "by": "bot", "objective": name, "weight": to.get(name, 0.0)}
        for number, name in enumerate(moved, 1)
    ]
