"""What participants' pages and bots are told in JSON. What a step tells is `steps.py`'s; words are the templates'."""

from __future__ import annotations

from typing import Literal

from pydantic import ConfigDict, Field

from desirepath.learning.policies.reason_codes import Did
from desirepath.learning.rules.rule import Rule
from desirepath.web.core.contract import Reply
from desirepath.web.participant.steps import StepNow

SessionWord = Literal["active", "paused", "completed", "withdrawn", "expired", "screened_out"]


class SessionState(Reply):
    """Where a session stands: what `GET /api/session/{token}` answers, and every change beside its own things."""

    state: SessionWord
    step: StepNow
    language: str
    stage_url: str | None = Field(None, description="where something is shown on the stage")


class Answered(SessionState):
    """The acknowledgement of an answer: it is stored."""

    accepted: Literal[True]
    duplicate: bool = Field(description="whether the same request had stored it before")


class StrokeProblemState(Reply):
    """Why a drawn path cannot be driven. Beside these: numbers of the sentence, SI units in their names."""

    model_config = ConfigDict(extra="allow")

    code: str
    message: str
    thing: str | None = None
    at: list[float] | None = None
    after_s: float | None = None
    distance_m: float | None = None
    duration_s: float | None = None


class DrawingReply(SessionState):
    """Where a drawing stands after a change of it."""

    problem: StrokeProblemState | None = None


class LiveRollout(Reply):
    """track: rows of [t s, x m, y m, yaw rad], yaw without jumps; arrives: whether it comes to the goal; looks_at: what
    moved its turning most on this way, the most first, where the step says so."""

    track: list[list[float]]
    arrives: bool
    looks_at: list[str] = []


class LiveReason(Reply):
    """did: what the own robot does otherwise than the usual one. own, usual: how much, in the measure's SI unit."""

    did: Did
    own: float | None = None
    usual: float | None = None


class LivePaths(Reply):
    """The ways that the robots of a step would take, in the order in which they stand on the stage. why: what the first
    one does otherwise than the second and its person's answers speak for, to be said after it drove."""

    place: int
    paths: list[LiveRollout]
    why: list[LiveReason] = []


class ReadPart(Reply):
    """A stretch of a sentence. reading: plain; wanted, unwanted (less of it) or lesser, of an objective; asked, by
    which question; missed."""

    model_config = ConfigDict(populate_by_name=True)

    text: str
    reading: Literal["plain", "wanted", "unwanted", "lesser", "asked", "missed"] = Field(alias="as")
    objective: str | None = None
    question: int | None = None


class ReadQuestion(Reply):
    """What is asked back, which objectives may have been meant, and why: unclear, or a contradiction, or slowness in
    general, which cannot be had."""

    text: str
    offered: list[str]
    about: Literal["unclear", "contradiction", "slowness"]


class WordsUnderstood(Reply):
    """What was read of a sentence: the whole of it in stretches, weights (objective -> above 0), what is asked back;
    language: in which it was read, where that is not the page's."""

    parts: list[ReadPart]
    weights: dict[str, float]
    questions: list[ReadQuestion]
    meant_weight: float
    language: str | None = None


class RuleAsked(Reply):
    """What is asked back of a rule: the words it is asked of, and for `wish` the objectives that they may mean."""

    about: Literal["context", "wish", "place", "nothing"]
    text: str
    offered: list[str]


class RuleReply(Reply):
    """A sentence as a rule, as far as it was understood."""

    rule: Rule
    asked: list[RuleAsked]


class FloorPicture(Reply):
    """A place from above, metres: its corners; outlines of walls and furniture; person x, y, yaw; start and goal."""

    low: list[float]
    high: list[float]
    walls: list[list[list[float]]]
    things: list[list[list[float]]]
    person: list[float]
    does: Literal["sits", "stands", "walks"]
    start: list[float]
    goal: list[float]


class RuleShown(Reply):
    """Where a rule applies there as the robot sets out: outlines of where it must not drive, of where the rule holds;
    what of its situation cannot be told in these homes; whether it holds at some time on the way."""

    zones: list[list[list[float]]]
    holds_in: list[list[list[float]]]
    unavailable: list[str]
    held: bool


class Collision(Reply):
    """Two rules, by their places in the list, that ask for opposites; about: the objective, or `zone`."""

    first: int
    second: int
    about: str


class RulesReply(Reply):
    """read: of the sentence that was sent; pair: the paths A and B of the rule to be checked, null: it makes no
    difference there."""

    floor: FloorPicture
    shown: list[RuleShown]
    collisions: list[Collision]
    path: LiveRollout
    read: RuleReply | None = None
    pair: list[LiveRollout] | None = None


class PlaceShown(Reply):
    """Which place the stage is told to show."""

    place: int


class TrialData(Reply):
    """The trajectories of the current trial as NPZ in base64, A and B, or all that have numbers, in their order."""

    shown: list[str]


class Joined(Reply):
    """A bot's session."""

    token: str
    participant: str
    simulated: bool


class JobNews(Reply):
    """The stream's event `job`: how long a participant waits for a training still. progress: share of the whole wait;
    before: people whose training comes first; seconds: until theirs is ready, null where nobody knows; at_most: until
    the session goes on without it."""

    progress: float
    before: int = 0
    running: bool = False
    seconds: int | None = None
    at_most: int | None = None
    done: bool


class Moved(Reply):
    """The stream's event `moved`: look anew, or another window of this session is the one in use now."""

    reason: Literal["step", "other_window"]
