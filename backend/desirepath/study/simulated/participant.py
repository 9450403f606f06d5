"""Simulated participants: programs that walk whole sessions, as a browser would, but need not watch.

Their sessions are marked as simulated when they are created; the server lets only these be fast and read the
trajectories. How one reaches its session is a `SessionClient`: over HTTP (`http.py`), in this process (`in_process.py`)
or in a browser. What it answers is each kind of step's own (`Kind.simulate`) and depends on its seed and number alone,
so all ways leave the same data.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NoReturn, Protocol

import numpy as np

from desirepath.learning.people.card import FAMILIES
from desirepath.learning.preferences.marked_steps import MOMENT_S, REACTION_S
from desirepath.learning.preferences.oracles import ALWAYS_RIGHT, Oracle, ResponseModel, make_oracle, preference_of
from desirepath.learning.preferences.spans import moments
from desirepath.learning.queries.queries import Query
from desirepath.report.simulated_cohorts import Cohort, SimulatedPerson
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import preference_setups
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.marks import GOOD, Why
from desirepath.store.sides import SIDES, Side
from desirepath.study.kind import KINDS

POLL_S = 0.5  # how often a waiting bot looks
DRAWING_TRIES = 20  # of one path, which is drawn another way every time
COMPARED = ("comparison", "method_comparison")  # kinds of step that compare robots, blind
# Of who may say that two do not differ, or how clearly, in typical differences; each bot its own. Ours.
NOTICES, MORE_TO_BE_CLEAR = (0.1, 0.5), (0.3, 1.5)
SEES_WITHIN = 0.1  # standard deviation of what it sees of a difference, likewise
REASONS: Mapping[str, Why] = {
    "farther": "too_close",
    "clearance": "too_close",
    "person_on_left": "wrong_side",
    "person_on_right": "wrong_side",
    "slower_near_person": "too_fast",
    "smoother": "jerky",
    "shorter": "detour",
}
"""What somebody calls a moment that is bad by the objective that they care for most."""
PATIENCE_S = 900.0  # a bot gives up on a session that stands still so long; the server's own limit comes first

SaidMark = dict[str, Any]
"""As an answer has it: {"at_s", "why"}."""
State = Mapping[str, Any]
"""Where a session stands, as the API tells a bot: {"state", "step": {...}}."""


class SimulationError(OSError):
    """A session that a simulated participant could not finish; says at which step and what the server answered."""


class SessionClient(Protocol):
    """How one simulated participant reaches its session."""

    def join(self, character: Mapping[str, Any]) -> str:
        """Take part as a simulated participant; character: the oracle's name and settings. Returns the code."""
        ...

    def come_back(self) -> State:
        """Go on with the next appointment, at once: it need not wait for its window."""
        ...

    def state(self) -> State: ...
    def start(self, key: str) -> State: ...
    def report_seen(
        self, key: str, side: Side, playback_id: str, *, worn: bool = False, marks: Sequence[SaidMark] = ()
    ) -> State:
        """worn: with a headset, which is a simulated one; marks: made meanwhile, where a page makes them."""
        ...

    def trajectories(self) -> list[Trajectory]:
        """All of the current trial, in the order of letters or numbers."""
        ...

    def draw(self, key: str, stroke: Mapping[str, Any]) -> State:
        """Send a drawn path; the state has `problem` where it cannot be driven."""
        ...

    def report_walk(self, key: str, playback_id: str, walk: Mapping[str, Any]) -> State:
        """Send what was walked beside the trajectory; the state has `problem` where the robot met the walker."""
        ...

    def submit(self, key: str, value: Mapping[str, Any]) -> State: ...


SIMULATED_HEADSET: Mapping[str, Any] = {
    "controllers": ["simulated"],
    "refresh_rate": None,
    "frames": 0,
    "dropped": 0,
    "pointing": [],
}
"""What is stored as the headset of who has no eyes (`HeadsetUsed`)."""


@dataclass(frozen=True)
class Walk:
    """What one bot did."""

    participant: str
    completed: bool
    responses: int
    comparisons: int


@dataclass(frozen=True)
class Character:
    """What all bots of a study are like. oracle, response_model: their preference and how answers stray from it; of
    several preferences with commas each bot takes the next one, of a family outside the list its next member. seed: of
    their random streams, every bot its own. cohort: what they rate, rank, and how conditions change their answers;
    None: they have no opinion on anything but trajectories. style: of drawing (`demonstrations`); default each
    bot the next one.
    """

    oracle: str = "min-human-distance"
    response_model: ResponseModel = ALWAYS_RIGHT
    seed: int = 0
    cohort: Cohort | None = None
    style: str | None = None

    def check(self) -> None:
        """Raises LearningError for an unknown oracle or response_model that cannot be."""
        for name in {*self.oracle.split(","), *(self.cohort.preferences.values() if self.cohort else ())}:
            make_oracle(name, **asdict(self.response_model), seed=self.seed)

    def preference(self, number: int) -> str:
        """The oracle of the bot of that number."""
        names = self.oracle.split(",")
        name = names[number % len(names)]
        return f"{name}:{number // len(names)}" if name in FAMILIES else name

    def as_stored(self, number: int) -> dict[str, Any]:
        """What is stored of a bot's making."""
        cohort = {"cohort": self.cohort.as_dict()} if self.cohort else {}
        style = {"style": self.style} if self.style else {}
        own = {"name": self.preference(number), **asdict(self.response_model), "seed": self.seed, "number": number}
        return {**own, **cohort, **style}


def walk_all(
    clients: Iterable[SessionClient], character: Character, tell: Callable[[str], None] = lambda words: None
) -> dict[str, Any]:
    """One simulated participant per client, one after another. tell: gets a line after every step.

    Returns {"participants", "completed", "responses", "comparisons", "codes", "seconds"}. Raises as `simulate_study`.
    """
    character.check()  # before anybody joins
    began = time.monotonic()
    walks = [SimulatedParticipant(client, character, number, tell).walk() for number, client in enumerate(clients)]
    return {
        "participants": len(walks),
        "completed": sum(walk.completed for walk in walks),
        "responses": sum(walk.responses for walk in walks),
        "comparisons": sum(walk.comparisons for walk in walks),
        "codes": [walk.participant for walk in walks],
        "seconds": round(time.monotonic() - began, 2),
    }


class SimulatedParticipant:
    """One simulated participant. random, person: what kinds of step make its answers of."""

    def __init__(
        self, client: SessionClient, character: Character, number: int, tell: Callable[[str], None] = lambda words: None
    ) -> None:
        self._client, self._cohort, self._tell = client, character.cohort, tell
        self.random = np.random.default_rng([character.seed, number, 11])
        self.person = character.cohort.person(number) if character.cohort else None
        stream = int(self.random.integers(2**31))
        self._usual = character.preference(number)
        names = {self._usual, *(character.cohort.preferences.values() if character.cohort else ())}
        response_model = asdict(character.response_model)
        self._oracles: dict[str, Oracle] = {name: make_oracle(name, **response_model, seed=stream) for name in names}
        self._style, self._number = character.style, number
        self._noise = np.random.default_rng([character.seed, number, 12])
        noticed = max(self._noise.uniform(*NOTICES), character.response_model.indifference)
        self._criteria = noticed, noticed + self._noise.uniform(*MORE_TO_BE_CLEAR)
        self._participant = client.join(character.as_stored(number))
        self._responses = self._comparisons = 0
        self._valued: dict[str, list[float]] = {}

    def walk(self) -> Walk:
        """From the first page to the last."""
        state = self._client.state()
        stood_since = time.monotonic()
        while state["state"] == "active" or state["step"]["kind"] == "appointment":
            step = state["step"]
            if step["kind"] == "appointment":
                state = self._client.come_back()
                continue
            if KINDS[step["kind"]].goes_on:
                if time.monotonic() - stood_since > PATIENCE_S:
                    self._give_up(f"waited {PATIENCE_S:.0f} s at step {step['key']!r}")
                time.sleep(POLL_S)
                state = self._client.state()
                continue
            value = KINDS[step["kind"]].simulate(step, self)
            self._comparisons += step["kind"] in COMPARED
            state = self._client.submit(step["key"], value)
            self._responses += not state["duplicate"]
            took = time.monotonic() - stood_since
            self._tell(
                f"{self._participant}: step {step['index'] + 1} of {step['total']} ({step['kind']}) after {took:.1f} s"
            )
            stood_since = time.monotonic()
        return Walk(self._participant, state["state"] == "completed", self._responses, self._comparisons)

    def watch(
        self, step: Mapping[str, Any], sides: str, marks: Sequence[SaidMark] = ()
    ) -> tuple[Trajectory, Trajectory]:
        """The way a page goes: start, A seen, B seen (or A alone). marks: made meanwhile."""
        state = self._client.start(step["key"])
        for side in sides:
            seen: Side = "a" if side == "a" else "b"
            shown = state["step"]["trial"]
            worn = bool(shown.get("worn"))
            state = self._client.report_seen(step["key"], seen, shown["playback_id"], worn=worn, marks=marks)
        a, b = self._client.trajectories()
        return a, b

    def choose(self, step: Mapping[str, Any], a: Trajectory, b: Trajectory) -> Side:
        """What the oracle prefers, then what the cohort makes of it."""
        if a.recorded is not None and "poses" not in a.recorded.has:
            return SIDES[self.random.integers(2)]  # nobody can measure a video
        condition, query, role = str(step.get("block")), str(step.get("query")), str(step.get("role"))
        choice = self._oracles[self._prefers(step)].choose(Query(a.scene, a, b, (0, 1)))
        if self.person is not None and step["kind"] not in COMPARED:
            if self.person.takes_second(condition, query, role):
                choice = 1
            else:
                choice ^= self.person.slips(condition, query, role)
        return "b" if choice else "a"

    def grade(
        self, step: Mapping[str, Any], a: Trajectory, b: Trajectory, *, no_difference: bool, degrees: bool
    ) -> dict[str, Any]:
        """What it chooses, and how clearly by its own criteria on what it sees of the difference, with noise."""
        choice = self.choose(step, a, b)
        if not (no_difference or degrees):
            return {"choice": choice}
        difference = self._noise.normal(0, SEES_WITHIN)
        name = self._prefers(step)
        if name != "random" and (a.recorded is None or "poses" in a.recorded.has):
            difference += float(self._oracles[name].advantages([Query(a.scene, a, b, (0, 1))])[0])
        noticed, clear = self._criteria
        if no_difference and abs(difference) < noticed:
            return {"degree": "no_difference"}
        return {"choice": choice} | ({"degree": "clear" if abs(difference) > clear else "slight"} if degrees else {})

    def _prefers(self, step: Mapping[str, Any]) -> str:
        """Its oracle under the step's condition."""
        return self._cohort.preferences.get(str(step.get("block")), self._usual) if self._cohort else self._usual

    def opinion(self, step: Mapping[str, Any], trajectory: Trajectory) -> float:
        """How much the oracle likes it, 0 to 1: its place among all that this participant was asked about so far."""
        name = self._prefers(step)
        if name == "random":
            return float(self.random.random())
        value, before = float(preference_of(name).value([trajectory])[0]), self._valued.setdefault(name, [])
        below = sum(earlier < value for earlier in before) + 0.5 * sum(earlier == value for earlier in before)
        before.append(value)
        return (below + 0.5) / len(before)

    def judge_several(self, step: Mapping[str, Any]) -> list[float]:
        """What each of several is worth to it, in typical differences, as it sees them; who lapses sees nothing."""
        drives = self._client.trajectories()
        noise = self._noise.normal(0, SEES_WITHIN / math.sqrt(2), len(drives))
        oracle = self._oracles[self._prefers(step)]
        if oracle.name == "random" or oracle.random.random() < oracle.response_model.lapse_rate:
            return [float(one) for one in noise]
        pairs = [Query(drives[0].scene, drives[0], drive, (0, 1)) for drive in drives]
        return [float(better + seen) for better, seen in zip(oracle.advantages(pairs), noise, strict=True)]

    def mark(self, step: Mapping[str, Any], *, good: bool) -> list[SaidMark]:
        """The part that seems worst to it, where that is clearly worse than the usual part, and the best one likewise;
        who lapses marks any part. Half of the time it says why, where its preference has a word for that."""
        marks = self._find_marks(step, self._client.trajectories()[0], good)
        self.watch(step, "a", marks)
        return marks

    def _find_marks(self, step: Mapping[str, Any], trajectory: Trajectory, good: bool) -> list[SaidMark]:
        name, recorded = self._prefers(step), trajectory.recorded
        measured = name != "random" and (recorded is None or "poses" in recorded.has)
        parts = moments(trajectory, MOMENT_S) if measured else [trajectory]
        parts = [part for part in parts if 2 * part.duration_s >= MOMENT_S]
        if len(parts) < 2:
            return []
        oracle = self._oracles[name]
        seems = self._noise.normal(0, SEES_WITHIN / math.sqrt(2), len(parts))
        if oracle.random.random() >= oracle.response_model.lapse_rate:
            seems += oracle.worth_of_parts(parts)
        noticed, usual = self._criteria[0], float(np.median(seems))
        marks: dict[int, Why | None] = {}
        if usual - seems.min() > noticed:
            said = REASONS.get((preference_of(name).objectives or ("",))[0])
            marks[int(seems.argmin())] = said if self._noise.random() < 0.5 else None
        if good and seems.max() - usual > noticed:
            marks[int(seems.argmax())] = GOOD
        ends = np.cumsum([part.duration_s for part in parts]) + REACTION_S
        return [
            {"at_s": round(min(float(ends[k]), trajectory.duration_s), 2), "why": why}
            for k, why in sorted(marks.items())
        ]

    def choose_weights(self, step: Mapping[str, Any]) -> dict[str, float]:
        """Its preference as weights, the foremost 1; none where it is not made of objectives."""
        name = self._prefers(step)
        preference = preference_of(name) if name != "random" else None
        weights = preference.weights if preference else None
        if preference is None or weights is None or not weights.max() > 0:
            return {}
        shares = zip(preference.names, weights / weights.max(), strict=True)
        return {objective: round(float(weight), 2) for objective, weight in shares if weight > 0}

    def draw(self, step: Mapping[str, Any]) -> dict[str, Any]:
        """A path in its style, drawn again where it touches something, then kept; of who has preference weights, where
        a policy takes weights, the way that it likes best.

        Where a walk has to be chosen, any of them; where the participant walks, a walk to any free place.
        """
        from desirepath.demonstrations.demonstrators import STYLES, draw_stroke  # numba comes with it
        from desirepath.study.simulated.imagined import imagine_stroke

        style = self._style or list(STYLES)[self._number % len(STYLES)]
        scenes = [Scene.from_dict(scene) for scene in step["scenes"]]
        weights = self.choose_weights(step) if scenes[0].setup in preference_setups() else {}
        problem: Any = None
        for tried in range(DRAWING_TRIES):
            choice = int(self.random.integers(len(scenes))) if len(scenes) > 1 else 0
            if weights:
                stroke = imagine_stroke(scenes[choice], weights, self.random, tried)
            else:
                stroke = draw_stroke(style, scenes[choice], int(self.random.integers(2**31)))
            state = self._client.draw(step["key"], stroke.as_sent() | {"pointer": "bot", "walk": choice})
            if state["step"]["trial"]["walking"]:
                state = self._walk(step["key"], scenes[choice], state["step"]["trial"])
            problem = state.get("problem")
            if problem is None:
                return {"stroke": state["step"]["trial"]["stroke"]}
        self._give_up(f"{DRAWING_TRIES} paths were refused, the last one: {problem}")

    def _walk(self, key: str, scene: Scene, shown: Mapping[str, Any]) -> State:
        from desirepath.demonstrations.planned_walks import record_walk  # numba comes with it

        times, poses = record_walk(scene, shown["duration_s"], int(self.random.integers(2**31)))
        walk = {"times_s": times.tolist(), "poses": poses.tolist()}
        return self._client.report_walk(key, shown["playback_id"], walk)

    def _give_up(self, why: str) -> NoReturn:
        raise SimulationError(f"participant {self._participant}: {why}")


@dataclass(frozen=True)
class _OnPages:
    """Whoever answers pages alone; nothing is watched or drawn."""

    random: np.random.Generator
    person: SimulatedPerson | None = None

    def watch(self, step: Mapping[str, Any], sides: str) -> tuple[Trajectory, Trajectory]:
        raise SimulationError(f"step {step['key']!r} is no page")

    def choose(self, step: Mapping[str, Any], a: Trajectory, b: Trajectory) -> Side:
        raise SimulationError(f"step {step['key']!r} is no page")

    def grade(
        self, step: Mapping[str, Any], a: Trajectory, b: Trajectory, *, no_difference: bool, degrees: bool
    ) -> dict[str, Any]:
        raise SimulationError(f"step {step['key']!r} is no page")

    def opinion(self, step: Mapping[str, Any], trajectory: Trajectory) -> float:
        raise SimulationError(f"step {step['key']!r} is no page")

    def judge_several(self, step: Mapping[str, Any]) -> list[float]:
        raise SimulationError(f"step {step['key']!r} is no page")

    def mark(self, step: Mapping[str, Any], *, good: bool) -> list[SaidMark]:
        raise SimulationError(f"step {step['key']!r} is no page")

    def draw(self, step: Mapping[str, Any]) -> dict[str, Any]:
        raise SimulationError(f"step {step['key']!r} is no page")

    def choose_weights(self, step: Mapping[str, Any]) -> dict[str, float]:
        raise SimulationError(f"step {step['key']!r} is no page")


def any_answer(step: Mapping[str, Any], random: np.random.Generator) -> dict[str, Any]:
    """A valid answer to any step that is a page, as the API tells it to simulated participants."""
    return KINDS[step["kind"]].simulate(step, _OnPages(random))
