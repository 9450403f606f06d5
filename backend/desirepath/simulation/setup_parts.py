"""What a `setup.yaml` says of asking people there and of learning from them: its parts `preferences`, `conditioning`
and `demonstrations`. Plain data; what is missing is computed where it is needed
(`learning/preferences/setup_settings.py`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from pydantic import ConfigDict, Field

_STRICT = ConfigDict(extra="forbid")
PLACES = 6  # scenes in which weights are changed by hand
Metres = Annotated[float, Field(gt=0, le=1_000)]
Seconds = Annotated[float, Field(gt=0, le=10_000)]
Positive = Annotated[float, Field(gt=0)]
Scenes = Annotated[tuple[Annotated[int, Field(ge=0, lt=2**63)], ...], Field(max_length=100)]


@dataclass(frozen=True)
class Closeness:
    """What a step costs who prefers `closer`: `least` in any case, since staying beside the person must not be
    free, rising to 1 over some `range_m`, from `enough_m` on: less never pays.
    """

    enough_m: Metres
    range_m: Metres
    least: Annotated[float, Field(ge=0, le=1)]

    __pydantic_config__ = _STRICT


@dataclass(frozen=True)
class Middle:
    """Of goal and person alike: the distance at which the offset along with it is 0, and 1 `unit_m` farther."""

    at_m: Metres
    unit_m: Metres

    __pydantic_config__ = _STRICT


@dataclass(frozen=True)
class PreferenceSettings:
    """How preferences are asked and weighed in a setup.

    typical: by measure, standard deviation of the difference within a pair; scales: by objective, reward per step of
    its step term at full weight; far_enough_m: where `farther` is content; middle: of the conditioning search;
    longest_shown_s: of a query's trajectory, longest_simulated_s: where simulated people are asked; places: which of
    the figures' scenes weights are changed by hand in.
    """

    typical: Mapping[str, Positive] = field(default_factory=dict)
    scales: Mapping[str, Annotated[float, Field(ge=0)]] = field(default_factory=dict)
    far_enough_m: Metres | None = None
    closeness: Closeness | None = None
    middle: Middle | None = None
    longest_shown_s: Seconds | None = None
    longest_simulated_s: Seconds | None = None
    places: Scenes = ()

    __pydantic_config__ = _STRICT

    def __post_init__(self) -> None:
        if 0 < len(self.places) < PLACES:
            raise ValueError(f"places: needed are {PLACES} scenes, or none")


@dataclass(frozen=True)
class EpisodeReward:
    """What an episode is about while a conditioned policy is trained, in reward, beside what is preferred.

    goal, collision, self_intersection: instead of the task's own: whoever pays per step must neither stay away from the
    goal nor crash to end it, nor drive in circles. progress: per metre. time: cost of a step, since waiting must not be
    free. turning: cost of a step of turning at full rate. The defaults are for rooms; time and turning are dear there
    because robots that would rather not pass the person wait or circle.
    """

    goal: Positive = 65.0
    collision: float = -80.0
    self_intersection: float = -6.0
    progress: float = 3.0
    time: float = 0.6
    turning: float = 0.6

    __pydantic_config__ = _STRICT


@dataclass(frozen=True)
class ConditioningSettings:
    """How a conditioned policy is trained in a setup; what each means: `learning/td3/conditioned_training.py`."""

    reward: EpisodeReward = EpisodeReward()
    gamma: Annotated[float, Field(gt=0, lt=1)] = 0.99
    updates: Annotated[int, Field(ge=1)] = 50_000
    checkpoints: Annotated[int, Field(ge=1)] = 4
    selection_scenes: Annotated[int, Field(ge=1)] = 150
    strengths: tuple[Positive, ...] = (1.0, 1.125, 1.25, 1.375, 1.5)
    recovery: bool = False

    __pydantic_config__ = _STRICT


@dataclass(frozen=True)
class DrawnPair:
    """A situation that paths are drawn in: where the robot begins and the person stands, x, y in m and yaw in rad, and
    where the goal is."""

    start: tuple[float, float, float]
    goal: tuple[float, float]
    person: tuple[float, float, float]

    __pydantic_config__ = _STRICT


@dataclass(frozen=True)
class DemonstrationSettings:
    """The situations that paths are drawn in, the same for everybody: `pairs` in the furniture of seed 0, or scenes by
    their `seeds`. depth_camera: controllers learned there go by one."""

    pairs: Annotated[tuple[DrawnPair, ...], Field(max_length=20)] = ()
    seeds: Scenes = ()
    depth_camera: bool = False

    __pydantic_config__ = _STRICT

    def __post_init__(self) -> None:
        if bool(self.pairs) == bool(self.seeds):
            raise ValueError("pairs, seeds: one of both says the situations")
