"""What participants' pages and bots are told in JSON. The pages' words are the templates', steps' texts too."""

from __future__ import annotations

from typing import Literal

from pydantic import ConfigDict, Field

from backend.api.core.contract import Told

SessionWord = Literal["active", "paused", "completed", "withdrawn", "expired", "screened_out"]
PairPhase = Literal["ready", "playing_a", "playing_b", "choosing", "answered"]
DrawingPhase = Literal["drawing", "ready", "driving", "watched"]


class TrialState(Told):
    """How the trajectories of a trial are being watched."""

    phase: PairPhase
    duration_a_s: float = Field(description="of the trajectory alone, without the letter before it")
    duration_b_s: float
    label_s: float = Field(description="how long the letter stands before a trajectory")
    restarts: int = Field(description="how often this trial had to begin again")
    replays: int = Field(description="how often both trajectories were watched again")
    next_side: Literal["a", "b"] = Field(description="which one Start plays: B where only B was cut short")
    playback_id: str | None = Field(description="what is playing now")


class DrawingState(Told):
    """How far a drawn path is."""

    phase: DrawingPhase
    walking: bool = Field(description="whether the participant walks beside the rollout")
    met: bool = Field(description="whether the robot met the participant on the last walk")
    stroke: str | None = Field(description="the drawn path that can be kept")
    duration_s: float | None = Field(description="of the rollout of the drawn path")
    playback_id: str | None = Field(description="what is playing now")
    may_skip: bool
    attempts: int


class StepState(Told):
    """The current step without its texts. Simulated sessions are told more, as bots read no pages."""

    model_config = ConfigDict(extra="allow")

    key: str
    kind: str
    index: int = Field(description="counted from 0 over the steps that this person meets in this appointment")
    total: int = Field(description="how many these will be, as far as it is known")
    trial: TrialState | DrawingState | None


class SessionState(Told):
    """Where a session stands: what `GET /api/session/{token}` answers, and every change beside its own things."""

    state: SessionWord
    step: StepState
    language: str
    stage_url: str | None = Field(None, description="where something is shown on the stage")


class Answered(SessionState):
    """The acknowledgement of an answer: it is stored."""

    accepted: Literal[True]
    duplicate: bool = Field(description="whether the same request had stored it before")


class StrokeProblemTold(Told):
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

    problem: StrokeProblemTold | None = None


class TrialData(Told):
    """Both trajectories of the current trial as NPZ in base64."""

    a: str
    b: str


class Joined(Told):
    """A bot's session."""

    token: str
    participant: str
    simulated: bool


class JobNews(Told):
    """The stream's event `job`: how far the training is that a participant waits for."""

    progress: float
    done: bool


class Moved(Told):
    """The stream's event `moved`: look anew, or another window of this session is the one in use now."""

    reason: Literal["step", "other_window"]
