"""What participants' pages and bots send, bounded field by field. Answers are `steps.py`'s."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    FailFast,
    Field,
    model_validator,
)

from desirepath.learning.rules.rule import MOST_RULES, Rule
from desirepath.learning.words.lexicon import LONGEST as LONGEST_SENTENCE
from desirepath.store.head_poses import FARTHEST_M, MOST_SAMPLES
from desirepath.study.drawing.strokes import MOST_POINTS
from desirepath.study.drawing.walks import MOST_POSES
from desirepath.study.robots import REACH_M
from desirepath.study.session.leaving import LONGEST_PROBLEM
from desirepath.study.session.platforms import PARAMETERS
from desirepath.study.wire import HeadsetUsed
from desirepath.web.core.contract import Clock, MaybeObject, OpenObject, Sent, storable
from desirepath.web.participant.steps import RequestId

LARGEST_EVENT = 4_000  # bytes of JSON; ours
LONGEST_DEVICE_VALUE = 40
LONGEST_UNDER_WAY_S = 60.0  # as long as the stage has people walk
LONGEST_ID = 200  # characters of what may be a recruiting platform's id, or a placeholder in its place

Side = Literal["a", "b"]
Cut = Literal["hidden", "webgl_lost", "connection", "unseen"]
WithinReach = Annotated[float, Field(allow_inf_nan=False, ge=-REACH_M, le=REACH_M)]
Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
# The first mistake is all that is told, and thousands cost tens of milliseconds in the loop that serves everybody.
Point = Annotated[list[Number], Field(min_length=2, max_length=2), FailFast()]
Pose = Annotated[list[Number], Field(min_length=3, max_length=3), FailFast()]
Points = Annotated[list[Point], Field(max_length=MOST_POINTS), FailFast()]
Poses = Annotated[list[Pose], Field(max_length=MOST_POSES), FailFast()]
NumberPerPoint = Annotated[list[Number], Field(max_length=MOST_POINTS), FailFast()]
NumberPerPose = Annotated[list[Number], Field(max_length=MOST_POSES), FailFast()]


def _small(data: dict[str, Any]) -> dict[str, Any]:
    if len(json.dumps(data)) > LARGEST_EVENT:
        raise ValueError(f"must have at most {LARGEST_EVENT} bytes of JSON")
    return data


PlatformsId = Annotated[str | None, Field(max_length=LONGEST_ID)]
Small = Annotated[MaybeObject, AfterValidator(_small)]


class Noticed(Sent):
    """Something the page noticed."""

    kind: Literal[
        "stage_ready",
        "stage_slow",
        "visibility",
        "resized",
        "script_error",
        "connection",
        "device",
        "viewed",
        "headset",
        "sound",
    ]
    data: Small = {}
    client_time: Clock = None


class ProblemReport(Sent):
    """What a participant writes by `report a problem`."""

    text: str = Field("", max_length=LONGEST_PROBLEM)


class Start(Sent):
    """Play the first trajectory that was not seen yet."""

    request_id: str = Field("", max_length=64)


class Seen(Sent):
    """A trajectory of a pair was watched to its end."""

    side: Side
    playback_id: str | None = Field(None, max_length=64)
    headset: HeadsetUsed | None = Field(None, description="of who watched all of it with one")


HeadSeconds = Annotated[float, Field(allow_inf_nan=False, ge=0, le=86_400)]
HeadNumber = Annotated[float, Field(allow_inf_nan=False, ge=-FARTHEST_M, le=FARTHEST_M)]
HeadAt = Annotated[list[HeadNumber], Field(min_length=7, max_length=7), FailFast()]
HeadTimes = Annotated[list[HeadSeconds], Field(min_length=1, max_length=MOST_SAMPLES), FailFast()]


class HeadMoved(Sent):
    """A few seconds of how a head moved in a headset. wearing, part: which time it was on, and the part's place in it;
    began_s: since it was put on; playback_id, playing_s: what was playing, seconds since the robot's first move;
    times_s (n,) from 0; poses (n, 7): x, y, z in m, unit quaternion x, y, z, w."""

    wearing: str = Field(pattern="^[0-9a-f]{16,32}$")
    part: int = Field(ge=0, le=100_000)
    began_s: HeadSeconds
    playback_id: str | None = Field(None, max_length=64)
    playing_s: Annotated[float, Field(allow_inf_nan=False, ge=-86_400, le=86_400)] | None = None
    times_s: HeadTimes
    poses: Annotated[list[HeadAt], Field(min_length=1, max_length=MOST_SAMPLES), FailFast()]


class Interrupted(Sent):
    """Something could not be watched to its end."""

    reason: Cut


class StrokeSent(Sent):
    """A drawn path: points (n, 2) m, speeds (n,) m/s wanted there, times_s (n,) of the hand."""

    request_id: RequestId
    points: Points
    speeds: NumberPerPoint
    times_s: NumberPerPoint
    pointer: str = Field("mouse", max_length=40, description="mouse, touch, pen, keys, controller, hand, gaze; with +")
    headset: HeadsetUsed | None = Field(None, description="of who drew it with one")
    walk: int | None = Field(None, ge=0, le=99, description="which of the walks that were offered")
    client_time: Clock = None


class WalkSent(BaseModel):
    """What a participant walked: times_s (n,), poses (n, 3) x, y, yaw in m and radians. Cleaned as part of its body."""

    model_config = ConfigDict(frozen=True)

    times_s: NumberPerPose
    poses: Poses


class RolloutSeen(Sent):
    """The rollout of a drawn path was watched to its end."""

    playback_id: str | None = Field(None, max_length=64)
    walk: WalkSent | None = None
    headset: HeadsetUsed | None = Field(None, description="of who watched all of it with one")


class WalkAgain(Sent):
    """Walk once more beside the rollout of the path that is there."""

    request_id: RequestId


class LiveAsked(Sent):
    """Which way would the robot take? weights: objective -> 0 to 1, None: as it was learned; poses: where the robots
    are, x, y, yaw in m and radians, None: at the start; since: for how many seconds each has been under way, and
    whoever walks there."""

    weights: dict[str, Number] | None = Field(None, max_length=20)
    place: int = Field(0, ge=0, le=99)
    poses: list[Pose] | None = Field(None, max_length=2)
    since: list[Annotated[float, Field(ge=0, le=LONGEST_UNDER_WAY_S)]] | None = Field(None, max_length=2)


class RulesAsked(Sent):
    """What would a robot do by these rules there, and where do they apply? sentence: one more, to be read. check: which
    of them is to be shown obeyed and broken."""

    rules: list[Rule] = Field([], max_length=MOST_RULES)
    place: int = Field(0, ge=0, le=99)
    sentence: str | None = Field(None, max_length=LONGEST_SENTENCE)
    check: int | None = Field(None, ge=0, lt=MOST_RULES)


class RobotWeights(Sent):
    """How a robot is to drive from now on: objective -> 0 to 1."""

    weights: dict[str, Number] = Field(max_length=20)


class PersonPointed(Sent):
    """Where a person stands, x, y in m from where the robot began, x ahead; None: nobody stands there any more."""

    place: list[WithinReach] | None = Field(None, min_length=2, max_length=2)


class WordsRead(Sent):
    """A wish in plain words, to be read; bounded before anything looks into it."""

    sentence: str = Field(max_length=LONGEST_SENTENCE)


class PlaceChosen(Sent):
    """Another place of the step, from 0."""

    place: int = Field(ge=0, le=99)


DEVICE_FIELDS = (
    *("width", "height", "pixel_ratio", "frame_rate"),
    *("pointer", "touch", "webgl", "scheme", "reduced_motion", "headset"),
)


def known_device(given: Any) -> dict[str, Any]:
    """What the device check found, only the fields we know, long words cut; {} for what is no such thing."""
    if isinstance(given, str):
        try:
            given = storable(json.loads(given))
        except (ValueError, RecursionError):
            given = None
    if not isinstance(given, dict):
        return {}
    known = {name: given[name] for name in DEVICE_FIELDS if isinstance(given.get(name), str | int | float | bool)}
    return {name: value[:LONGEST_DEVICE_VALUE] if isinstance(value, str) else value for name, value in known.items()}


class Joining(Sent):
    """The way in: a form of the welcome page, or a bot's JSON. From PROLIFIC_PID on: what recruiting platforms send, in
    small or capital letters; `study/session/platforms.py` reads it."""

    language: str = Field("", max_length=LONGEST_ID)
    device: Annotated[dict[str, str | float | int | bool], BeforeValidator(known_device)] = Field(
        {}, description=f"what the device check measured: {', '.join(DEVICE_FIELDS)}"
    )
    simulated: bool = False
    oracle: OpenObject | None = Field(None, description="which simulated person answers; of simulated sessions only")
    PROLIFIC_PID: PlatformsId = None
    STUDY_ID: PlatformsId = None
    SESSION_ID: PlatformsId = None
    survey_code: PlatformsId = None
    id: PlatformsId = None
    workerId: PlatformsId = None
    assignmentId: PlatformsId = None
    hitId: PlatformsId = None

    @model_validator(mode="before")
    @classmethod
    def _named_in_any_case(cls, given: Any) -> Any:
        named = given.items() if isinstance(given, dict) else ()
        return {PARAMETERS.get(name.lower(), name): value for name, value in named} or given
