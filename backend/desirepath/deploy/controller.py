"""A policy that drives a robot: one command per control period, by the rules of every engine."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.deploy.bundle import Bundle, Driving
from desirepath.deploy.conditioning import WeightsError
from desirepath.deploy.deciding import Decider
from desirepath.deploy.inputs import Command, InputError, Odometry, Person, Scan, check_goal
from desirepath.deploy.manifest import Limits, Robot
from desirepath.deploy.observing import Mount, Observer
from desirepath.deploy.steering import Progress, stand

Floats = NDArray[np.float32]
STANDING = "standing"


class Controller:
    """Drives a robot by a bundle; `step` is asked once per `period_s`.

    `observation` (obs,), `action` (2,) and `driven_by` ("policy", "recovery 1", ..., "standing") are of the last step;
    `arrived`: whether the robot was at its goal in it. `chosen`: which of the bundle's policies drives, where it has
    several; `decider` chooses; `drives`: how many began. `command` is what the robot was last told: who lets it do
    something else says so here, since accelerations are counted from it.
    """

    def __init__(self, bundle: Bundle, laser: Mount | None = None) -> None:
        """laser: where the robot's lidar is (x, y in m, yaw in rad), where that is not as the policy learned. Raises
        BundleError for a policy that reads what nothing on a robot tells."""
        self._bundle, found = bundle, bundle.manifest
        self._laser = laser or (found.lidar.x, found.lidar.y, found.lidar.yaw)
        self._observe = Observer(found, self._laser)
        self._goal, self._person = found.place("goal_distance") or 0, found.place("person_distance") or 0
        self._weights, self._driving = dict(bundle.weights), bundle.at(bundle.weights)
        self.decider: Decider | None = None
        self.undecided = ""  # why nobody decides any more
        self.drives = 0
        self.reset()

    @classmethod
    def load(cls, source: Path | str | bytes, laser: Mount | None = None) -> Controller:
        """Of a folder, a zip, or a zip's bytes. Raises BundleError."""
        return cls(Bundle.read(source), laser)

    def reset(self) -> None:
        """Begin anew, standing: with another goal, or after the robot was stopped."""
        found = self._bundle.manifest
        self.command = Command(0.0, 0.0)
        self.observation: Floats = np.zeros(len(found.inputs), dtype=np.float32)
        self.action: Floats = np.zeros(2, dtype=np.float32)
        self.driven_by, self.arrived = "policy", False
        self.chosen, self.drives = 0, self.drives + 1
        if self._bundle.choices:
            self._driving = self._bundle.choices[0]
        if self.decider is not None:
            self.decider.begin(self._laser)
        last = max(len(one.networks) for one in self._bundle.choices or (self._driving,))
        self._progress = Progress(1, last, found.period_s, found.recovery) if found.recovery else None

    def copy(self) -> Controller:
        """One that goes on from here and leaves this one as it is."""
        other = copy.copy(self)
        other._progress = copy.deepcopy(self._progress)
        other.decider = None
        return other

    @property
    def manifest(self) -> Mapping[str, Any]:
        """All that the bundle's manifest says."""
        return self._bundle.manifest.content

    @property
    def period_s(self) -> float:
        return self._bundle.manifest.period_s

    @property
    def limits(self) -> Limits:
        return self._bundle.manifest.limits

    @property
    def robot(self) -> Robot:
        return self._bundle.manifest.robot

    @property
    def laser(self) -> Mount:
        """Where the lidar whose scans it is given is in the robot's frame: x, y (m), yaw (rad)."""
        return self._laser

    @property
    def objectives(self) -> tuple[str, ...]:
        """What weights may name; empty where the policy takes none."""
        return self._bundle.conditioning.objectives if self._bundle.conditioning else ()

    @property
    def weights(self) -> Mapping[str, float]:
        """By objective; set them while it drives. What is not named weighs nothing. Raises WeightsError."""
        return dict(self._weights)

    @weights.setter
    def weights(self, weights: Mapping[str, float]) -> None:
        if self._bundle.conditioning is None:
            raise WeightsError("the policy takes no weights: it was trained without, or exported with its own")
        checked = self._bundle.conditioning.checked(weights)
        self._weights, self._driving = checked, self._bundle.at(checked)

    def step(self, scan: Scan, odometry: Odometry, goal: tuple[float, float], people: Sequence[Person] = ()) -> Command:
        """What to do for the next period. Raises InputError for what cannot be gone by; the robot must then stop."""
        x, y = check_goal(goal)
        observation = self._observe(scan, odometry, (x, y), people)
        self.arrived = float(np.hypot(x - odometry.x, y - odometry.y)) <= self._bundle.manifest.goal_radius_m
        command = self.decide(observation)
        if self.decider is not None:
            try:
                self.decider.stepped(scan, odometry, (x, y), people, observation, self.action)
            except Exception as problem:  # it may be anything: the robot drives on by its usual policy
                self.undecided, self.decider = str(problem) or type(problem).__name__, None
                self.drive_by(0)
        return command

    @property
    def choices(self) -> int:
        """How many policies the bundle is; 0: it is one."""
        return len(self._bundle.choices)

    @property
    def content(self) -> bytes:
        """The policy's file, where the bundle is several: what a decider is made of."""
        return self._bundle.content

    def ask_who_drives(self) -> Callable[[], int] | None:
        """What decides, after a step, which policy drives on: for `drive_by`. None: it is not time, or nobody does."""
        return None if self.decider is None else self.decider.ask()

    def drive_by(self, place: int) -> None:
        """The bundle's policy of that place drives from now on. Raises IndexError for none."""
        if not 0 <= place < self.choices:
            raise IndexError(f"place = {place}: the bundle has {self.choices} policies")
        if place != self.chosen and self._progress is not None:
            self._progress.begin_anew(np.zeros(1, dtype=np.int64))
        self.chosen, self._driving = place, self._bundle.choices[place]

    def decide(self, observation: Floats) -> Command:
        """The same from an observation (obs,). Raises InputError where the policy's action is not a number."""
        self.observation, driving = observation, self._driving
        self.action = self._action(driving, observation[None])[0]
        if not np.isfinite(self.action).all():
            raise InputError("the policy's action is not a number; nothing can be driven by it here")
        self.command = self._within_limits(*map(float, self.action))
        return self.command

    def _action(self, driving: Driving, observed: Floats) -> Floats:
        """(1, 2) in [-1, 1]: of who drives, slowed."""
        number, inputs = 0, self._bundle.manifest.inputs
        if self._progress is not None:
            distance = observed[:, self._goal].astype(np.float64) * inputs[self._goal].divided_by
            number = int(self._progress.drivers(distance, np.zeros(1, dtype=np.int64))[0])
        if len(driving.networks) == 1:  # one of several that has nothing to recover by
            number = 0
        standing = number >= len(driving.networks)
        self.driven_by = STANDING if standing else f"recovery {number}" if number else "policy"
        if standing:
            return stand(observed)
        actions = driving.networks[number](observed)
        if driving.slowing is None:
            return actions
        return driving.slowing.limited(actions, observed[:, self._person] * np.float32(inputs[self._person].divided_by))

    def _within_limits(self, forward: float, turning: float) -> Command:
        limits, before, period = self.limits, self.command, self.period_s
        v = (min(max(forward, -1.0), 1.0) + 1) / 2 * (limits.v_max - limits.v_min) + limits.v_min
        w = min(max(turning, -1.0), 1.0) * limits.w_max
        if self.arrived:
            v = w = 0.0
        if limits.v_change is not None:
            v = min(max(v, before.v - limits.v_change * period), before.v + limits.v_change * period)
        if limits.w_change is not None:
            w = min(max(w, before.w - limits.w_change * period), before.w + limits.w_change * period)
        return Command(v, w)
