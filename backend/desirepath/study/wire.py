"""What kinds of step say on the wire: their answers, how far they are, what simulated participants are told besides.

Bases and what several kinds share; a kind's own models stand in its file. No kind by itself. The published contract is
put together of all kinds' in `web/participant/steps.py`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, FailFast, Field, ValidationError

from desirepath.grammar.error_words import describe_expected_json
from desirepath.store.sides import Side
from desirepath.study.refusals import Refused

PairPhase = Literal["ready", "playing_a", "playing_b", "choosing", "answered"]


class BadValue(Refused):
    """A value that is no answer; names the field and what would work."""

    def __init__(self, field: str, value: Any, message: str) -> None:
        super().__init__(422, "bad_value", message, field=field, value=value)


# ---- what is sent ----------------------------------------------------------------------------------------------------


class Answer(BaseModel):
    """Base of what is sent as the `value` of an answer. What it does not know is left aside: pages may be older."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    @classmethod
    def read(cls: type[A], value: object) -> A:
        """That value as an answer of the kind. Raises BadValue for what is none."""
        if not isinstance(value, dict):
            raise BadValue("value", value, "must be an object")
        missing = {name: None for name, of in cls.model_fields.items() if of.is_required()}
        try:
            return cls.model_validate(missing | value)  # so that what is missing is told what it must be, too
        except ValidationError as wrong:
            error = wrong.errors(include_url=False)[0]
            field = ".".join(str(part) for part in ("value", *error["loc"]))
            raise BadValue(field, error.get("input"), describe_expected_json(error)) from None


A = TypeVar("A", bound=Answer)


class Confirmed(Answer):
    """Read or watched; there is nothing to answer."""


class HeadsetUsed(BaseModel):
    """With what headset something was watched, as far as a browser tells: controllers: their profiles' names; pictures
    per second it asks for, drawn, and left out; pointing: with what. Cleaned as part of its body."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    controllers: Annotated[list[Annotated[str, Field(max_length=60)]], Field(max_length=4), FailFast()] = []
    refresh_rate: float | None = Field(None, gt=0, le=1000, allow_inf_nan=False)
    frames: int = Field(0, ge=0, le=10**7)
    dropped: int = Field(0, ge=0, le=10**7)
    pointing: Annotated[list[Literal["controller", "hand", "gaze"]], Field(max_length=3), FailFast()] = []


class InRoomAnswer(Answer):
    """Base of one that is given beside the room, in the immersive view with a headset or in the window."""

    headset: HeadsetUsed | None = Field(None, description="of who gives it with one")


STORED_IN_ROOM = {
    "hmd": "of the immersive view alone: whether it was answered with a headset on",
    "headset": "likewise: with what, as of trials (controllers, refresh_rate, pointing); null: in the window",
}
"""What is stored of where such an answer was given (`session/watching.py`)."""


class ChoiceAnswer(Answer):
    """One of two."""

    choice: Side


def whole(value: object) -> int:
    """A whole number, also one that was typed. Raises ValueError."""
    if isinstance(value, str) and value.strip().lstrip("-").isdigit() and len(value) < 12:
        return int(value)
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError("must be a whole number")
    return value


WholeNumber = Annotated[int, BeforeValidator(whole)]
Flag = Annotated[bool, BeforeValidator(lambda value: value is True)]
"""True where it says so; whatever else stands there means that it does not."""

# ---- what is told ----------------------------------------------------------------------------------------------------


class Progress(BaseModel):
    """Base of how far a step's own trial or drawing is."""

    model_config = ConfigDict(frozen=True)


class TrialState(Progress):
    """How the trajectories of a trial are being watched."""

    phase: PairPhase
    duration_a_s: float = Field(description="of the trajectory alone, without the letter before it")
    duration_b_s: float
    label_s: float = Field(description="how long the letter stands before a trajectory")
    restarts: int = Field(description="how often this trial had to begin again")
    replays: int = Field(description="how often both trajectories were watched again")
    next_side: Side = Field(description="which one Start plays: B where only B was cut short")
    worn: bool | None = Field(None, description="to be watched with a headset, or in the window; null: as one likes")
    playback_id: str | None = Field(description="what is playing now")
    videos: dict[Side, str] | None = Field(None, description="addresses of what is shown in the stage's place")


class Besides(BaseModel):
    """Base of what simulated sessions are told beside what pages show. Nobody else is, so no field is required."""

    model_config = ConfigDict(frozen=True)


class AboutQuery(Besides):
    """Which query a trial asks."""

    role: str | None = None
    query: str | None = Field(None, description="none where the trial is of none")
