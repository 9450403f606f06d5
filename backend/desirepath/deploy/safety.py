"""What stands between a controller and a robot's wheels: when it may drive, how fast, and what stops it.

Pure: a clock is passed in, messages come in, commands go out; one thread. No ROS, no files.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from typing import Protocol

import numpy as np

from desirepath.deploy.inputs import MOST_PEOPLE, Command, InputError, Odometry, Person, Scan, check_goal
from desirepath.deploy.outline import AT_ONCE, Body, Braking, Outline, People, Points, Touch, Way, points_of

FRESH_TO_START = 3  # messages in a row
DRIFT = 2e-4  # of two clocks
NEAR_M = 0.3  # beyond its outline that a robot's lidar may not see
PROMPT = 0.85  # of a control period: a scan that comes so early is acted on at once, not left until the period is over
JUMP_M, JUMP_RAD = 0.2, 0.5  # that odometry may be corrected by at once, beside what a robot can drive
SLOWER = (0.7, 0.5, 0.35, 0.25, 0.15, 0.1)
"""Shares of a commanded speed that are tried where something is in the way; after them turning alone."""
SLOWEST = 0.1  # m/s: a robot so slow may turn alone out of what is in its way
CREEPING = 0.02  # m/s: a command so slow is turning alone
TURNING = 0.05  # rad/s: a command that turns by no more is looked at as one that does not
STANDING = Command(0.0, 0.0)


class State(str, Enum):
    """off: commands nothing. armed: stands, and may be started. driving. stopped: stands until it is armed again."""

    OFF = "off"
    ARMED = "armed"
    DRIVING = "driving"
    STOPPED = "stopped"


class Refused(RuntimeError):
    """An arm or start that is not done, and why."""


@dataclass(frozen=True)
class Transition:
    """That the state changed: at_s on the supervisor's clock, and why."""

    at_s: float
    state: State
    reason: str


@dataclass(frozen=True)
class Rules:
    """stale_s: a robot stands so long after its last fresh scan or odometry; tick_s: how often the supervisor is asked.
    people_stale_s: and after the last news of people, where they come by messages. keep_out_m: between the centres of
    robot and person; None: by the robot's own size, APART_M from its outline to the circle around the person.
    collision_s: it slows down where it would touch something so soon on the way that it is commanded, or come within
    the keep-out distance of somebody, as they walk, or before it stands, and stops where that does not help, or did
    not for slowed_s; 0: no stop zone. braking, m/s^2: how hard it brakes, or by v_change where that is less. armed_s:
    how long an armed robot waits to be started.
    v_max, w_max, v_change, w_change (m/s, rad/s, and those a second): tighter limits than the controller's own.

    The numbers are ours.
    """

    stale_s: float = 0.3
    tick_s: float = 0.02
    people_stale_s: float = 1.0
    keep_out_m: float | None = None
    collision_s: float = 0.2
    braking: float = 2.5
    slowed_s: float = 10.0
    armed_s: float = 60.0
    v_max: float | None = None
    w_max: float | None = None
    v_change: float | None = None
    w_change: float | None = None

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            may_be_nothing = one.name in ("keep_out_m", "collision_s")
            if value is None and one.default is None:
                continue
            if not (math.isfinite(value) and (value > 0 or (value == 0 and may_be_nothing))):
                least = "0 or more" if may_be_nothing else "above 0"
                raise InputError(f"rule {one.name} = {value!r}: must be a number, {least}")
        if self.tick_s > self.stale_s / 3:
            raise InputError(f"rule tick_s = {self.tick_s:g}: must be at most a third of stale_s, {self.stale_s:g}")


LONGEST_BRAKING_S = 10.0
"""Ours: what is looked at before each command grows with it."""


class Limits(Protocol):
    """What a robot can: m/s, rad/s, and those a second (None: as quick as commanded)."""

    @property
    def v_min(self) -> float: ...
    @property
    def v_max(self) -> float: ...
    @property
    def w_max(self) -> float: ...
    @property
    def v_change(self) -> float | None: ...
    @property
    def w_change(self) -> float | None: ...


class Controls(Protocol):
    """What is supervised: `deploy.controller.Controller`."""

    command: Command

    @property
    def limits(self) -> Limits: ...
    @property
    def robot(self) -> Body: ...
    @property
    def laser(self) -> tuple[float, float, float]: ...
    @property
    def period_s(self) -> float: ...
    @property
    def arrived(self) -> bool: ...

    def step(
        self, scan: Scan, odometry: Odometry, goal: tuple[float, float], people: Sequence[Person] = ()
    ) -> Command: ...
    def reset(self) -> None: ...


@dataclass
class _Stream:
    """Messages of one kind with the sender's stamps, of which only the order and the pace are believed.

    fresh_at: when the last fresh one was measured, on our clock, if none ever came more promptly than by its stamp;
    heard_at: when it came. trouble: what was wrong with the last one.
    """

    name: str
    stale_s: float
    fresh_at: float = -math.inf
    heard_at: float = -math.inf
    in_a_row: int = 0
    trouble: str = ""
    _stamp: float | None = None
    _behind: float = math.inf  # least of what our clock was ahead of stamps
    _at_first: float = -math.inf  # the same of the first message

    def forget(self) -> None:
        """Begin anew: nothing is fresh, another clock may be behind the stamps."""
        self.__init__(self.name, self.stale_s)  # type: ignore[misc]

    def refuse(self, why: str) -> None:
        self.trouble, self.in_a_row = why, 0

    def take(self, stamp: float, now: float) -> bool:
        """Whether a message of that stamp, which is here now, is fresh."""
        if not math.isfinite(stamp):
            self.refuse(f"its stamp is {stamp}")
            return False
        if self._stamp is not None:
            passed = stamp - self._stamp
            if passed <= 0:
                self.refuse(f"its time went {'back' if passed else 'not on'} from {self._stamp:.3f} to {stamp:.3f}")
                return False
            self._behind += DRIFT * (now - self.heard_at)
            self._at_first -= DRIFT * passed
        else:
            self._at_first = now - stamp
        if self._at_first - (now - stamp) > self.stale_s:
            self.refuse(f"its clock gained {self._at_first - (now - stamp):.3f} s on ours")
            self.fresh_at = -math.inf  # or ours stands still: then nothing would ever be too old
            return False
        self._behind = min(self._behind, now - stamp)
        self._stamp, self.heard_at = stamp, now
        late = now - stamp - self._behind
        if late >= self.stale_s:
            self.refuse(f"it came {late:.3f} s late")
            return False
        self.fresh_at, self.trouble = now - late, ""  # not by the stamp, which may be too huge to count in
        self.in_a_row += 1
        return True

    def missing(self, now: float, since_s: float) -> str | None:
        """Why nothing fresh is there; None where it is."""
        if now - self.fresh_at < since_s:
            return None
        ago = "none yet" if self.fresh_at == -math.inf else f"the last {now - self.fresh_at:.2f} s ago"
        return f"no fresh {self.name}: {ago}" + (f"; {self.trouble}" if self.trouble else "")


class Supervisor:
    """Asks a controller for commands while it is driving, and sends nothing that breaks a rule.

    `off -> arm() -> armed -> start() -> driving -> stopped`, and `arm()` again: nothing else makes it drive. A stop
    commands 0 at once, whatever the accelerations; otherwise speeds change within a control period by no more than the
    accelerations allow in it.
    """

    def __init__(
        self,
        controller: Controls,
        clock: Callable[[], float],
        rules: Rules | None = None,
        told: Callable[[Transition], None] | None = None,
        needs_people: bool = False,
        body: Body | None = None,
    ) -> None:
        """clock: seconds that only go on (`time.monotonic`). told: hears of every change of state. needs_people: it is
        not started before `people` said where they are. body: the robot's outline, if not the controller's. Raises
        InputError for a robot that cannot stand, or that takes too long to."""
        limits = controller.limits
        if not (limits.v_min <= 0 < limits.v_max and limits.w_max > 0):
            raise InputError(
                f"limits v_min = {limits.v_min:g}, v_max = {limits.v_max:g}, w_max = {limits.w_max:g}: "
                "v_min <= 0 < v_max and w_max > 0 are needed; a robot that cannot stand cannot stop"
            )
        self.controller, self.rules = controller, rules or Rules()
        slowest = min(self.rules.braking, self.rules.v_change or math.inf, limits.v_change or math.inf)
        if limits.v_max / slowest > LONGEST_BRAKING_S:
            raise InputError(
                f"braking = {slowest:g} m/s^2 from v_max = {limits.v_max:g} m/s: must take at most "
                f"{LONGEST_BRAKING_S:g} s; nobody looks farther ahead"
            )
        self._clock, self._told = clock, told
        self.state, self.reason = State.OFF, "not armed yet"
        self.command = STANDING
        self._scans, self._odometry = (_Stream(name, self.rules.stale_s) for name in ("scan", "odometry"))
        self._news = _Stream("news of people", self.rules.people_stale_s)
        self._scan: Scan | None = None
        self._shape: tuple[float, ...] | None = None  # of the scans since arming
        self._points: Points = np.zeros((0, 2))
        self._where: Odometry | None = None
        self._goal: tuple[float, float] | None = None
        self._people: tuple[Person, ...] | None = None if needs_people else ()
        self._walkers = People.told(())
        self._staying = True  # people, until something else is heard
        self._held = ""  # who holds the stop
        self._due = self._new = False  # a scan came that nothing was done about; it came just now
        self._now, self._since, self._stepped = -math.inf, -math.inf, -math.inf
        self._changed = self._free = -math.inf  # the command; when nothing was in the way of what the controller wants
        self._body = Outline(body or controller.robot, self.rules.keep_out_m)
        self.steps = 0  # that the controller was asked for

    @property
    def where(self) -> Odometry | None:
        """The last good odometry since arming; before it, what there is."""
        return self._where

    @property
    def seen(self) -> Scan | None:
        """The last good scan likewise."""
        return self._scan

    @property
    def told_of(self) -> tuple[Person, ...]:
        """Where people are, as far as it was told."""
        return self._people or ()

    # What comes in

    def scan(self, scan: Scan) -> None:
        """A turn of the lidar. One that is not fresh or not whole counts as none."""
        now = self._time()
        shape = (len(scan.ranges), scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max)
        before = self._shape
        if before is not None and shape != before and self.state is not State.OFF:
            return self._scans.refuse(
                f"{shape[0]} ranges from {shape[1]:g} by {shape[2]:g} rad, of {shape[3]:g} to {shape[4]:g} m; were "
                f"{before[0]} from {before[1]:g} by {before[2]:g} rad, of {before[3]:g} to {before[4]:g} m"
            )
        if invalid := int(np.isnan(scan.ranges).sum()):
            return self._scans.refuse(f"{invalid} of {len(scan.ranges)} ranges are NaN")
        if self._fresh(self._scans, scan.stamp_s, now):
            self._scan, self._shape, self._due, self._new = scan, shape, True, True
            self._points = points_of(scan, self.controller.laser)

    def odometry(self, odometry: Odometry) -> None:
        """Where the robot is, and how it moves."""
        now, limits = self._time(), self.controller.limits
        fastest = 1.5 * max(limits.v_max, -limits.v_min) + 0.1
        if abs(odometry.v) > fastest or abs(odometry.w) > 1.5 * limits.w_max + 0.5:
            return self._odometry.refuse(f"it says {odometry.v:g} m/s and {odometry.w:g} rad/s; the robot cannot")
        before = self._where
        if before is not None and self.state is State.DRIVING:
            moved = math.hypot(odometry.x - before.x, odometry.y - before.y)
            turned = abs(math.remainder(odometry.yaw - before.yaw, math.tau))
            passed = max(odometry.stamp_s - before.stamp_s, 0.0)
            if moved > JUMP_M + fastest * passed or turned > JUMP_RAD + 1.5 * limits.w_max * passed:
                return self._odometry.refuse(f"it jumped by {moved:.2f} m and {turned:.2f} rad")
        if self._fresh(self._odometry, odometry.stamp_s, now):
            self._where = odometry

    def people(self, people: Sequence[Person], lasting: bool = False, stamp_s: float | None = None) -> None:
        """Where people are; lasting: and where they stay until something else is heard. stamp_s: when that was, on the
        sender's clock; None: now. News that is not fresh counts as none, and more than MOST_PEOPLE stop the robot."""
        now = self._time()
        if len(people) > MOST_PEOPLE:
            return self.stop(f"{len(people):,} people are told of; at most {MOST_PEOPLE:,} can be")
        if stamp_s is None:
            self._news.fresh_at = self._news.heard_at = now
        elif not self._fresh(self._news, stamp_s, now):
            self._staying = False  # who tells of them by messages must go on
            return None
        self._people, self._walkers, self._staying = tuple(people), People.told(people, lasting), lasting
        return None

    def goal(self, goal: tuple[float, float]) -> None:
        """Where to; a robot that drives goes there from now on. Raises InputError."""
        self._goal = check_goal(goal)
        self._begin()

    def broken(self, what: str, why: str) -> None:
        """A scan or odometry came that could not be read."""
        (self._scans if what == "scan" else self._odometry).refuse(why)

    def hold(self, who: str, held: bool) -> None:
        """A stop that lasts: while it is held, nothing arms the robot."""
        self._held = who if held else ""
        if held:
            self.stop(f"{who} says stop")

    # Acts of whoever answers for the robot

    def arm(self, by: str = "by hand") -> None:
        """Get ready; the robot stands. by: whose act it is. Raises Refused."""
        self._time()
        if self._held:
            raise Refused(f"not armed: {self._held} still says stop")
        if self.state is State.DRIVING:
            raise Refused("not armed: it is driving; stop it first")
        for stream in (self._scans, self._odometry, self._news):
            stream.forget()
        self._shape = self._scan = self._where = None
        self._be(State.ARMED, f"armed {by}")

    def start(self, by: str = "by hand") -> None:
        """Drive. Raises Refused."""
        now = self._time()
        if not math.isfinite(now):
            raise Refused("not started: the clock says nothing")
        if self.state is not State.ARMED:
            raise Refused(f"not started: it is {self.state.value} ({self.reason}); arm it first")
        why: str | Touch | None = None
        for stream in (self._scans, self._odometry):
            if why is None and stream.in_a_row < FRESH_TO_START:
                why = stream.missing(now, self.rules.stale_s) or (
                    f"only {stream.in_a_row} messages of {stream.name} in a row were fresh, {FRESH_TO_START} are needed"
                )
        if why is None and self._goal is None:
            why = "no goal yet"
        if why is None and self._people is None:
            why = "the policy observes people, and nobody said where they are, nor that there are none"
        why = why or self._blind() or self._danger(now)
        if (why := why or self._ahead(now, STANDING)) is not None:
            raise Refused(f"not started: {why}")
        self._begin()
        self._stepped = self._changed = now - self.controller.period_s
        self._free = now
        self._be(State.DRIVING, f"started {by}")

    def stop(self, why: str) -> None:
        """Stand at once, until somebody arms and starts again."""
        self.command = self.controller.command = STANDING
        if self.state in (State.ARMED, State.DRIVING):
            self._be(State.STOPPED, why)

    def off(self) -> None:
        """Command nothing any more."""
        self.stop("turned off")
        self._be(State.OFF, "turned off by hand")

    def tick(self) -> Command:
        """What the robot is to do now: ask after every scan, and every `tick_s`."""
        now = self._time()
        if self.state is State.ARMED and now - self._since > self.rules.armed_s:
            self._be(State.OFF, f"armed for {self.rules.armed_s:g} s and not started")
        elif self.state is State.DRIVING:
            try:
                why = self._go_on(now)
            except Exception as problem:  # whatever it is, the robot stands
                why = f"it failed to look ahead: {problem or type(problem).__name__}"
            if why is not None:
                self.stop(why)
        self._new = False
        return self.command

    # How

    def _go_on(self, now: float) -> str | None:
        """Why the robot must stop instead."""
        why = self._danger(now) or self._command(now, self.command)
        share = PROMPT if self._new else 1.0
        if why is None and self._due and now - self._stepped >= share * self.controller.period_s:
            why = self._step(now)
        return why

    def _begin(self) -> None:
        """Let the controller forget its way, not how fast it is."""
        self.controller.reset()
        self.controller.command = self.command

    def _time(self) -> float:
        """The clock; one that says nothing counts as one that went back."""
        now = self._clock()
        if not math.isfinite(now):
            now = -math.inf
        if now < self._now:
            for stream in (self._scans, self._odometry, self._news):
                stream.forget()
            self.stop(f"the clock went from {self._now:.3f} to {now:.3f}")
        self._now = now
        return now

    def _be(self, state: State, reason: str) -> None:
        self.state, self.reason, self._since = state, reason, self._now
        self.command = STANDING
        if self._told is not None:
            try:
                self._told(Transition(self._now, state, reason))
            except Exception as problem:  # who listens must not keep a robot from standing
                self.reason += f" (not recorded: {problem})"

    def _fresh(self, stream: _Stream, stamp: float, now: float) -> bool:
        fresh = stream.take(stamp, now)
        if not fresh and self.state is not State.DRIVING:  # nobody drives by it: get used to another clock
            trouble = stream.trouble
            stream.forget()
            stream.take(stamp, now)
            stream.refuse(trouble)
            stream.fresh_at = -math.inf
        return fresh

    def _danger(self, now: float) -> str | None:
        """What speaks against driving on at all."""
        rules, where = self.rules, self._where
        for stream in (self._scans, self._odometry):
            if missing := stream.missing(now, rules.stale_s - 2 * rules.tick_s):
                return missing
        if not self._staying and (missing := self._news.missing(now, rules.people_stale_s)):
            return missing
        return None if where is None else self._too_near(now, where)

    def _people_around(self, now: float, where: Odometry) -> People:
        """Who it was told of, in the robot's frame, where they are by now."""
        stamped, heard = (
            0.0 if self._staying else min(now - at, self.rules.people_stale_s)
            for at in (self._news.fresh_at, self._news.heard_at)
        )
        return self._walkers.seen_from(where, stamped, heard)

    def _too_near(self, now: float, where: Odometry) -> str | None:
        """Whether somebody is within the keep-out distance, on whichever side and however the robot moves, or walks
        into it until the robot stands."""
        goes = Command(where.v, where.w if where.v or self._body.turns_m else 0.0)
        react_s = now - self._odometry.fresh_at + self.rules.tick_s
        way = self._until_it_stands(now, goes, react_s if goes != STANDING else 0.0, goes)
        found = self._body.nearest(self._people_around(now, where), way)
        if found is None:
            return None
        when_s, away, kept = found
        return f"somebody {'will be' if when_s else 'is'} {away:.2f} m away, the keep-out distance is {kept:.3g} m"

    def _blind(self) -> str | None:
        """Whether the lidar cannot see what the stop zone is about."""
        needed = self._zone_m()
        scan = self._scan
        if (
            not self.rules.collision_s
            or scan is None
            or (scan.range_min <= self._body.around_m + NEAR_M and scan.range_max >= needed)
        ):
            return None
        return f"the scan sees from {scan.range_min:g} to {scan.range_max:g} m; the stop zone reaches to {needed:.2f} m"

    def _zone_m(self) -> float:
        """How far from the robot's centre the stop zone reaches at most."""
        fastest = max(self.controller.limits.v_max, -self.controller.limits.v_min)
        return self._body.around_m + fastest * (self._react_s(0.0) + fastest / self._slows[0] / 2)

    def _react_s(self, age: float) -> float:
        """How long after the last scan or odometry the way must be free: until the next is acted on or missed."""
        return max(self.rules.collision_s, age + self.rules.tick_s)

    def _ahead(self, now: float, command: Command, braking: bool = False) -> Touch | None:
        """What is in the stop zone of this command: on its way until the robot reacts, and while it brakes from what it
        drives and turns now. braking: it does so already, and is left none but a tick to react."""
        if not self.rules.collision_s:
            return None
        way, where = self._way(now, command, braking), self._where
        thing = self._body.first_touch(self._points, way)
        met = None if where is None else self._body.first_met(self._people_around(now, where), way)
        return min((touch for touch in (thing, met) if touch is not None), key=lambda touch: touch.when_s, default=None)

    def _way(self, now: float, command: Command, braking: bool) -> Way:
        """How the robot goes on by this command until it stands."""
        where, age_s = self._where, now - min(self._scans.fresh_at, self._odometry.fresh_at)
        drives = Command(where.v, where.w) if where is not None else command
        react_s = age_s + self.rules.tick_s if braking else self._react_s(age_s)
        return self._until_it_stands(now, command, react_s, drives)

    def _until_it_stands(self, now: float, command: Command, react_s: float, drives: Command) -> Way:
        """By this command for so long, then braking, from how it drives now where that is faster. It turns for as long
        as it drives, so that it keeps to the arc, or for longer where turning brakes less. Commanded to turn, so much
        slower than it drives now that it still brakes to that by then, or alone, it rolls on."""
        driving = turning = AT_ONCE
        slows, slows_turning = self._slows
        along = max(math.copysign(1.0, drives.v) * command.v, CREEPING)
        least = along + (slows * react_s if abs(command.v) > CREEPING else 0.0)
        rolls = abs(command.w) > TURNING and abs(drives.v) > least
        if rolls:
            command = Command(math.copysign(along, drives.v), command.w)
            driving = _brake(command.v, drives.v, slows)
        elif abs(command.v) > CREEPING:
            driving = turning = _brake(command.v, drives.v, slows)
        if abs(command.w) > TURNING:
            turning = _brake(command.w, drives.w, slows_turning, driving.takes_s)
        return Way(command, react_s, driving, turning, now - self._odometry.fresh_at, rolls)

    @property
    def _slows(self) -> tuple[float, float]:
        """m/s^2 and rad/s^2 that it brakes by."""
        limits, rules = self.controller.limits, self.rules
        driving = self._least(rules.braking, limits.v_change, rules.v_change) or rules.braking
        return driving, self._least(limits.w_change, rules.w_change) or driving / self._body.around_m

    def _step(self, now: float) -> str | None:
        """Ask the controller; why the robot must stop instead."""
        scan, where, goal = self._scan, self._where, self._goal
        if scan is None or where is None or goal is None:
            return "no scan, odometry or goal"
        try:
            wanted = self.controller.step(scan, where, goal, self._people or ())
        except Exception as problem:
            return f"the controller failed: {problem or type(problem).__name__}"
        if not (math.isfinite(wanted.v) and math.isfinite(wanted.w)):
            return f"the controller commanded {wanted.v} m/s and {wanted.w} rad/s"
        command = self.limited(wanted, now - self._changed)
        if why := self._command(now, command, asked=True):
            return why
        self._due, self._stepped, self.steps = False, now, self.steps + 1
        if self.controller.arrived and command == STANDING:
            return "arrived"
        return None

    def _command(self, now: float, wanted: Command, *, asked: bool = False) -> str | None:
        """Command this, slower where something is in the way; why the robot must stop instead. asked: whether the
        controller wants it just now, so that it is not what goes on."""
        command, in_the_way = wanted, self._ahead(now, wanted)
        if in_the_way is not None:
            slower = self._slower(now, wanted, in_the_way)
            if slower is None:
                return str(in_the_way)
            if now - self._free > self.rules.slowed_s:
                return f"{in_the_way}; slowed down for {now - self._free:.0f} s"
            command = slower
        elif asked:
            self._free = now
        if command != self.command:
            self.command, self._changed = command, now
        self.controller.command = command
        return None

    def _slower(self, now: float, wanted: Command, touch: Touch) -> Command | None:
        """The same way at the fastest speed at which nothing is in the way, else turning alone, else braking by what
        changes of speed allow, else, for somebody who walks, standing until they are past, or, rolling on, until it
        stands; None for none of these.
        Where the last scan is older the robot has moved since: then slower for people alone, or braking."""
        passed, seen = now - self._changed, now - self._scans.fresh_at <= 2 * self.rules.tick_s
        if not seen and touch.who is None:
            return self._brakes(now, passed)
        slower = [Command(share * wanted.v, share * wanted.w) for share in SLOWER]
        if self._ahead(now, self.limited(slower[-1], passed)) is not None:
            slower = []  # nor is any other, and each takes its time
        if seen and self._where is not None and abs(self._where.v) < SLOWEST:
            slower.append(Command(0.0, wanted.w))
        for one in slower:
            command = self.limited(one, passed)
            if command != STANDING and self._ahead(now, command) is None:
                return command
        if (brakes := self._brakes(now, passed)) is not None:
            return brakes
        rolls = self._where is not None and abs(self._where.v) > CREEPING >= abs(wanted.v)
        waits = rolls or (touch.who is not None and touch.who > 0)
        waits = waits and self.limited(STANDING, passed) == STANDING
        return STANDING if waits and self._ahead(now, STANDING) is None else None

    def _brakes(self, now: float, passed_s: float) -> Command | None:
        """What it drives by, slower by as much as the accelerations allow; None: they allow standing, or even braking
        so from now on would touch something."""
        v = self.limited(STANDING, passed_s).v
        if not v:
            return None
        command = self.limited(Command(v, self.command.w * v / self.command.v), passed_s)
        return command if self._ahead(now, command, braking=True) is None else None

    def limited(self, wanted: Command, passed_s: float) -> Command:
        """A command within the limits, and within the accelerations of what is commanded now. Where it is too fast, it
        turns less in the same measure: the way stays the same."""
        limits, rules = self.controller.limits, self.rules
        v_max = self._least(limits.v_max, rules.v_max) or limits.v_max
        w_max = self._least(limits.w_max, rules.w_max) or limits.w_max
        v_min = max(limits.v_min, -v_max)
        v = min(max(wanted.v, v_min), v_max)
        w = wanted.w * (v / wanted.v if v else 1.0)
        w = min(max(w, -w_max), w_max)
        passed = min(max(passed_s, 0.0), self.controller.period_s)
        v = _near(v, self.command.v, self._least(limits.v_change, rules.v_change), passed)
        w = _near(w, self.command.w, self._least(limits.w_change, rules.w_change), passed)
        return Command(v, w)

    @staticmethod
    def _least(*numbers: float | None) -> float | None:
        return min((number for number in numbers if number is not None), default=None)


def _brake(commanded: float, now: float, slows: float, least_s: float = 0.0) -> Braking:
    """From a commanded speed, or what it is now where that is faster."""
    fastest = max(abs(commanded), abs(now))
    takes_s = max(fastest / slows, least_s)
    return Braking(takes_s, fastest * takes_s / 2 / abs(commanded))


def _near(wanted: float, now: float, change: float | None, passed: float) -> float:
    return wanted if change is None else min(max(wanted, now - change * passed), now + change * passed)
