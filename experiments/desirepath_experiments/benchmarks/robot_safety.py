"""`desirepath benchmark robot-safety`: everything wrong that a robot can hear, at random; does it ever drive on?

Time is simulated. What is good of what is sent is known here, and nothing of how the supervisor judges it.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from desirepath.deploy.inputs import MOST_PEOPLE, Command, InputError, Odometry, Person, Scan
from desirepath.deploy.manifest import Limits, Robot
from desirepath.deploy.safety import Refused, Rules, State, Supervisor, Transition
from desirepath_experiments.benchmarks.results import Progress

BEAMS, RANGE_M = 90, 6.0
LATENCY_S = 0.002
SLACK_S = 1e-6  # of clocks that say 1e7
MIN_LEAD_S = 0.9  # of a scan's period: how early the next one may come


@dataclass(frozen=True)
class RobotSafetyConfig:
    """How much is sent."""

    messages: Annotated[int, Field(ge=100, description="Scans and odometries.")] = 1_000_000
    seed: int = 0


class _Wild:
    """A controller that commands anything, and sometimes what is none. It stands for every policy there is."""

    period_s, arrived, laser = 0.2, False, (0.1, 0.0, 0.0)
    robot = Robot("wild", 0.2, None)

    def __init__(self, rng: np.random.Generator, limits: Limits) -> None:
        self._rng, self.limits, self.command, self.wrong = rng, limits, Command(0.0, 0.0), False

    def reset(self) -> None:
        self.command = Command(0.0, 0.0)

    def step(self, scan: Scan, odometry: Odometry, goal: tuple[float, float], people: Any = ()) -> Command:
        kind = self._rng.random()
        self.wrong = kind < 0.004
        if kind < 0.001:
            raise ValueError("no action")
        if self.wrong:
            return Command(*self._rng.permutation([self._rng.choice([math.nan, math.inf, -math.inf]), 0.1]))
        scale = 1e6 if kind < 0.05 else 2.0
        return Command(float(self._rng.normal(0.3, scale)), float(self._rng.normal(0, scale)))


class _Trial:
    """A robot that drives as it is told, a supervisor, and what goes wrong between them."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.t, self.clock_error = 10.0, 0.0
        limits = Limits(float(self.rng.choice([0.0, -0.3])), 0.8, 2.0, 1.5, 4.0)
        self.controller = _Wild(self.rng, limits)
        keep_out_m = 0.5 if self.rng.random() < 0.5 else None
        self.rules = Rules(v_max=float(self.rng.choice([0.5, 5.0])), keep_out_m=keep_out_m)
        self.supervisor = Supervisor(self.controller, lambda: self.t + self.clock_error, self.rules, told=self._told)
        self.supervisor.goal((1e5, 0.0))
        self.pose, self.told, self.trouble = [0.0, 0.0, 0.0], Command(0.0, 0.0), "none"
        self.until, self.next_scan, self.next_odometry, self.next_people = self.t, self.t, self.t, self.t
        self.good = {"scan": -math.inf, "odometry": -math.inf}
        self.stamp_error, self.alike_until = 0.0, 0.0
        self.allowed, self.forbidden, self.person_near = False, "", False
        self.changed_at = -math.inf
        self.counts: Counter[str] = Counter()
        self.stops: Counter[str] = Counter()
        self.longest_s = self.drove_s = self.longest_people_s = 0.0
        self.people_at = math.inf  # when the last good news of people was true

    def _told(self, change: Transition) -> None:
        self.allowed = change.state is State.DRIVING
        if change.state is State.STOPPED:
            self.stops[self.trouble] += 1
            self.counts["stops without a reason"] += not change.reason

    def run(self, messages: int) -> None:
        """Send about so many."""
        while self.counts["scans"] + self.counts["odometries"] < messages:
            if self.t >= self.until:
                self._next_trouble()
            step = float(self.rng.uniform(0.001, self.rules.tick_s * 0.75))
            self._move(step)
            self._operate()
            self._send()
            self._look(self.supervisor.tick())

    def _next_trouble(self) -> None:
        everything = [*_SCANS, *_ODOMETRIES, *_PEOPLE, *_OTHERS]
        self.trouble = "none" if self.rng.random() < 0.5 else str(self.rng.choice(everything))
        self.until = self.t + float(self.rng.uniform(0.05, 2.0))
        self.stamp_error = 0.0
        if self.trouble in _ALIKE:
            self.alike_until = self.until + (0.2 if self.trouble not in _PEOPLE else 0.6)
        if self.trouble == "clock back":
            self.clock_error -= float(self.rng.uniform(0.001, 50))
            self._forbid("the clock went back")
        if self.trouble == "clock ahead":
            self.clock_error += float(self.rng.uniform(1, 1e7))

    def _forbid(self, why: str) -> None:
        """From the next tick on the robot stands, until somebody starts it."""
        self.forbidden = why

    def _move(self, step: float) -> None:
        x, y, yaw = self.pose
        v, w = self.told.v, self.told.w
        self.pose = [
            x + v * math.cos(yaw) * step,
            y + v * math.sin(yaw) * step,
            math.remainder(yaw + w * step, math.tau),
        ]
        self.t += step
        self.clock_error -= step if self.trouble == "clock stands" else 0.0
        self.drove_s += step * (self.told != Command(0.0, 0.0))

    def _operate(self) -> None:
        """Whoever answers for the robot, who presses buttons at any time."""
        one = self.supervisor
        chance = self.rng.random()
        if self.trouble == "stop held" and self.t > self.until - 1:
            one.hold("/stop", True)
            self._forbid("the stop is held")
        elif one.state is State.DRIVING:
            if chance < 0.0005:
                one.stop("by hand")
                self._forbid("stopped by hand")
            elif chance < 0.001:
                one.off()
                self._forbid("turned off")
            elif chance < 0.002:
                self._try(one.arm)
        elif chance < 0.05:
            one.hold("/stop", False)
            self._try(one.arm)
        elif chance < 0.1 and self.t > self.alike_until:
            self._try(one.start)
            if self.allowed:
                self.forbidden, self.changed_at = "", self.t - 0.2

    def _try(self, act: Callable[[], None]) -> None:
        try:
            act()
        except Refused as why:
            self.counts["refusals without a reason"] += not str(why)

    def _send(self) -> None:
        if self.t >= self.next_scan:
            self.next_scan = self.t + float(self.rng.uniform(MIN_LEAD_S, 1.0)) * 0.1
            for _ in range(20 if self.trouble == "burst" else 1):
                self.counts["scans"] += 1
                self._scan()
        if self.t >= self.next_odometry:
            self.next_odometry = self.t + 0.04
            self.counts["odometries"] += 1
            self._odometry()
        if self.t >= self.next_people:
            self.next_people = self.t + float(self.rng.uniform(0.05, 0.25))
            self._tell_of_people()

    def _tell_of_people(self) -> None:
        """Somebody who walks anywhere; what the node does with who is none."""
        rng, wrong = self.rng, self.trouble
        near = wrong == "person near"
        away, where = (rng.uniform(0, 0.25) if near else 3.0), rng.uniform(-math.pi, math.pi)
        x, y = self.pose[0] + away * math.cos(where), self.pose[1] + away * math.sin(where)
        v_x, v_y = (float(one) for one in rng.normal(0, 1, 2))
        values: dict[str, Any] = {"x": x, "y": y, "v_x": v_x, "v_y": v_y, "stamp_s": self.t - LATENCY_S, "count": 1}
        if wrong in _PEOPLE and not _PEOPLE[wrong](self, values):
            return
        stamp, count = values.pop("stamp_s"), values.pop("count")
        try:
            people = [] if wrong == "nobody there" else [Person(**values)] * count
        except InputError as problem:
            self.supervisor.stop(str(problem))
            return self._forbid("a person who is none")
        self.supervisor.people(people, stamp_s=stamp)
        if near:
            self._forbid("a person is near")
        if count > MOST_PEOPLE:
            self._forbid("more people than there can be")
        if wrong not in _PEOPLE or wrong in _TOLD_WELL or self._gets_used_to_it():
            self.people_at = self.t

    def _scan(self) -> None:
        rng, wrong = self.rng, self.trouble
        measured = self.t - LATENCY_S - float(rng.uniform(0, 0.003))
        values: dict[str, Any] = {
            "stamp_s": measured,
            "angle_min": -math.pi,
            "angle_increment": math.tau / BEAMS,
            "range_min": 0.1,
            "range_max": RANGE_M,
            "ranges": rng.uniform(3.0, 7.0, BEAMS),
        }
        good = wrong not in _SCANS
        if good and rng.random() < 0.002:
            values["ranges"][rng.integers(BEAMS)] = rng.uniform(0.1, 1.0)  # that may stop the robot
        if not good and not _SCANS[wrong](self, values):
            return
        try:
            scan = Scan(**values)
        except InputError as problem:
            return self.supervisor.broken("scan", str(problem))
        self.supervisor.scan(scan)
        if good or self._gets_used_to_it():
            self.good["scan"] = measured
        elif wrong == "scans ever later":  # that old it is, and no older
            self.good["scan"] = max(self.good["scan"], scan.stamp_s)

    def _odometry(self) -> None:
        x, y, yaw = self.pose
        measured = self.t - LATENCY_S
        values = {"stamp_s": measured, "x": x, "y": y, "yaw": yaw, "v": self.told.v, "w": self.told.w}
        good = self.trouble not in _ODOMETRIES
        if not good and not _ODOMETRIES[self.trouble](self, values):
            return
        try:
            odometry = Odometry(**values)
        except InputError as problem:
            return self.supervisor.broken("odometry", str(problem))
        self.supervisor.odometry(odometry)
        if good or self._gets_used_to_it():
            self.good["odometry"] = measured

    def _gets_used_to_it(self) -> bool:
        """While a robot stands, another clock or lidar than before may be its own."""
        return self.trouble in _ALIKE and self.supervisor.state is not State.DRIVING

    def _look(self, command: Command) -> None:
        """Hold what the robot is told against what it may be told."""
        self.counts["commands"] += 1
        limits, before, counts = self.controller.limits, self.told, self.counts
        v_max = min(limits.v_max, self.rules.v_max or math.inf)
        within = limits.v_min <= command.v <= v_max and abs(command.w) <= limits.w_max
        counts["commands beyond the limits"] += not within
        moving = command != Command(0.0, 0.0)
        if command != before:
            passed = min(self.t - self.changed_at, 0.2) + SLACK_S
            quick = abs(command.v - before.v) > 1.5 * passed or abs(command.w - before.w) > 4.0 * passed
            counts["commands beyond the accelerations"] += quick and (moving or self.supervisor.state is State.DRIVING)
            self.changed_at = self.t
        if moving:
            counts["commands nobody started"] += not self.allowed or bool(self.forbidden)
            counts["commands of no number"] += self.controller.wrong
            self.longest_s = max(self.longest_s, *(self.t - at for at in self.good.values()))
            self.longest_people_s = max(self.longest_people_s, self.t - self.people_at)
        if self.supervisor.state is not State.DRIVING:
            self.controller.wrong = False
        self.told = command


def _set(**to: Callable[[_Trial, dict[str, Any]], Any]) -> Callable[[_Trial, dict[str, Any]], bool]:
    """A message with these values instead."""

    def change(trial: _Trial, values: dict[str, Any]) -> bool:
        values.update({name: value(trial, values) for name, value in to.items()})
        return True

    return change


def _shift(least: float, most: float) -> Callable[[_Trial, dict[str, Any]], Any]:
    """A stamp that is off by so many seconds, the same for a while."""

    def shifted(trial: _Trial, values: dict[str, Any]) -> float:
        trial.stamp_error = trial.stamp_error or float(trial.rng.uniform(least, most))
        return float(values["stamp_s"]) + trial.stamp_error

    return shifted


def _ever_later(trial: _Trial, values: dict[str, Any]) -> float:
    """The stamp of a message that was longer on its way than the one before."""
    trial.stamp_error -= 0.06
    return float(values["stamp_s"]) + trial.stamp_error


def _any_of(*numbers: float) -> Callable[[_Trial, dict[str, Any]], Any]:
    return lambda trial, _: float(trial.rng.choice(numbers))


def _with_nan(trial: _Trial, values: dict[str, Any]) -> Any:
    return np.where(np.arange(BEAMS) < trial.rng.integers(1, BEAMS + 1), math.nan, values["ranges"])


_SCANS: dict[str, Callable[[_Trial, dict[str, Any]], bool]] = {
    "no scans": lambda trial, values: False,
    "NaN": _set(ranges=_with_nan),
    "wrong count": _set(ranges=lambda trial, values: values["ranges"][: trial.rng.integers(0, BEAMS)]),
    "reversed angles": _set(angle_min=lambda *_: math.pi, angle_increment=lambda *_: -math.tau / BEAMS),
    "angles that are none": _set(angle_increment=_any_of(math.nan, math.inf, 0.0, 1e9, -1.0)),
    "ranges that are none": _set(range_max=_any_of(math.nan, math.inf, -1.0, 1e9), range_min=_any_of(0.0, 1e300)),
    "stamp that is none": _set(stamp_s=_any_of(math.nan, math.inf, -math.inf, 1e300, -1e300)),
    "the same scan": _set(stamp_s=lambda trial, values: trial.good["scan"]),
    "scans of long ago": _set(stamp_s=_shift(-1e5, -0.31)),
    "scans ever later": _set(stamp_s=_ever_later),
    "scans of the future": _set(stamp_s=_shift(0.45, 1e5)),
    "huge stamps": _set(stamp_s=_any_of(1e18, 9.9e5, -9.9e5)),
    "stamps too huge to count in": _set(stamp_s=lambda trial, values: 1e18 + values["stamp_s"] * 1e3),
}
_ODOMETRIES: dict[str, Callable[[_Trial, dict[str, Any]], bool]] = {
    "no odometry": lambda trial, values: False,
    "odometry of no number": _set(x=_any_of(math.nan, math.inf, -math.inf, 1e300)),
    "speeds that no robot has": _set(v=_any_of(1e3, -50.0, math.inf, 1e6)),
    "turning that no robot does": _set(w=_any_of(1e3, -50.0, math.nan)),
    "odometry elsewhere": _set(x=_any_of(9e5, -1e5)),
    "the same odometry": _set(stamp_s=lambda trial, values: trial.good["odometry"]),
    "odometry of long ago": _set(stamp_s=_shift(-1e5, -0.31)),
    "odometry of the future": _set(stamp_s=_shift(0.45, 1e5)),
}
_PEOPLE: dict[str, Callable[[_Trial, dict[str, Any]], bool]] = {
    "no news of people": lambda trial, values: False,
    "people of no number": _set(v_x=_any_of(math.nan, math.inf, 1e9), x=_any_of(0.0, math.nan)),
    "people who fly": _set(v_x=_any_of(9e5, -9e5), v_y=_any_of(9e5, -9e5)),
    "a crowd": _set(count=lambda *_: MOST_PEOPLE),
    "more people than there can be": _set(count=lambda *_: 10 * MOST_PEOPLE),
    "people of long ago": _set(stamp_s=_shift(-1e5, -1.01)),
    "people of the future": _set(stamp_s=_shift(1.5, 1e5)),
    "the same news of people": _set(stamp_s=lambda trial, values: trial.people_at - LATENCY_S),
    "stamps of people that are huge": _set(stamp_s=_any_of(1e18, 9.9e5, -9.9e5)),
}
_TOLD_WELL = {"people who fly", "a crowd"}
_ALIKE = {
    "people of long ago",
    "people of the future",
    "stamps of people that are huge",
    "the same news of people",
    "scans of long ago",
    "scans of the future",
    "odometry of long ago",
    "odometry of the future",
    "odometry elsewhere",
}
_ALIKE |= {
    "reversed angles",
    "scans ever later",
    "ranges that are none",
    "wrong count",
    "stamps too huge to count in",
    "turning that no robot does",
}
"""Troubles that look like another robot where they were there from the start: nobody starts in them."""
_OTHERS = ("burst", "clock back", "clock ahead", "clock stands", "person near", "nobody there", "stop held")


def benchmark_robot_safety(config: RobotSafetyConfig, progress: Progress | None = None) -> dict[str, Any]:
    """Simulated: what a supervised robot was told while it heard all that; every count but the first ones must be 0."""
    counts: Counter[str] = Counter(
        {
            "commands beyond the limits": 0,
            "commands beyond the accelerations": 0,
            "commands nobody started": 0,
            "commands of no number": 0,
            "stops without a reason": 0,
            "refusals without a reason": 0,
        }
    )
    stops: Counter[str] = Counter()
    longest = longest_people = drove = 0.0
    trials = max(1, min(20, config.messages // 1_000))
    for trial in range(trials):
        one = _Trial(config.seed * 1_000 + trial)
        one.run(config.messages // trials)
        counts.update(one.counts)
        stops.update(one.stops)
        longest, drove = max(longest, one.longest_s), drove + one.drove_s
        longest_people = max(longest_people, one.longest_people_s)
        if progress is not None:
            progress.tell(f"{counts['scans'] + counts['odometries']:,} of {config.messages:,} messages")
    return {
        **{name.replace(" ", "_"): count for name, count in sorted(counts.items())},
        "stop_s": round(longest, 4),
        "stop_without_news_of_people_s": round(longest_people, 4),
        "drove_s": round(drove, 1),
        "stops_by_trouble": dict(sorted(stops.items())),
    }
