"""Simulated participants: programs that walk whole sessions, as a browser would, but need not watch.

Their sessions are marked as simulated when they are created; the server lets only these be fast and read the drives.
How a bot reaches its session is a `Way`: over HTTP here, in this process in `in_process.py`; what it answers depends on
its seed and number alone, so both ways leave the same data.
"""

from __future__ import annotations

import base64
import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Protocol
from uuid import uuid4

import httpx
import numpy as np

from backend.learning.preferences.oracles import ALWAYS_RIGHT, Oracle, ResponseModel, make_oracle
from backend.learning.queries.queries import Query
from backend.report.made_up_cohorts import Cohort, MadeUpPerson
from backend.simulation.scene import Scene
from backend.simulation.trajectory import Trajectory
from backend.study.grammar.skipping import ItemWhen
from backend.study.grammar.words import DRAWN_KINDS, SINGLE_KINDS
from backend.study.links import next_token

POLL_S = 0.5  # how often a waiting bot looks
BUSY_TRIES = 20  # of a request that a busy server put off (503); nothing of it was stored, so it is simply sent again
DRAWING_TRIES = 20  # of one path, which is drawn another way every time
PATIENCE_S = 900.0  # a bot gives up on a session that stands still so long; the server's own limit comes first

State = Mapping[str, Any]
"""Where a session stands, as the API tells a bot: {"state", "step": {...}}."""


class BotError(OSError):
    """A session that a bot could not finish; says at which step and what the server answered."""


class Way(Protocol):
    """How one bot reaches its session."""

    def join(self, told: Mapping[str, Any]) -> str:
        """Take part as a simulated participant; told: the oracle's name and settings. Returns the code."""
        ...

    def come_back(self) -> State:
        """Go on with the next appointment, at once: bots need not wait for its window."""
        ...

    def state(self) -> State: ...
    def start(self, key: str) -> State: ...
    def seen(self, key: str, side: str, playback_id: str) -> State: ...
    def drives(self) -> tuple[Trajectory, Trajectory]: ...
    def draw(self, key: str, stroke: Mapping[str, Any]) -> State:
        """Send a drawn path; the state has `problem` where it cannot be driven."""
        ...

    def walked(self, key: str, playback_id: str, walk: Mapping[str, Any]) -> State:
        """Send what was walked beside the drive; the state has `problem` where the robot met the walker."""
        ...

    def submit(self, key: str, value: Mapping[str, Any]) -> State: ...


@dataclass(frozen=True)
class Walk:
    """What one bot did."""

    participant: str
    completed: bool
    responses: int
    comparisons: int


@dataclass(frozen=True)
class Character:
    """What all bots of a study are like. oracle, response_model: their preference (of several with commas each takes
    the next one) and how answers stray from it; seed: of their random streams, every bot its own. cohort: what they
    rate, rank, and how conditions change their answers; None: they have no opinion on anything but drives. style: of
    drawing (backend/demonstrations); default each bot the next one.
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

    def taste(self, number: int) -> str:
        """The oracle of the bot of that number."""
        names = self.oracle.split(",")
        return names[number % len(names)]

    def told(self, number: int) -> dict[str, Any]:
        """What is stored of a bot's making."""
        cohort = {"cohort": self.cohort.as_dict()} if self.cohort else {}
        style = {"style": self.style} if self.style else {}
        own = {"name": self.taste(number), **asdict(self.response_model), "seed": self.seed, "number": number}
        return {**own, **cohort, **style}


def put_off_s(response: httpx.Response) -> float | None:
    """How long a busy server asks to wait before the same request is sent again; None: it has answered."""
    return float(response.headers.get("Retry-After", 1)) if response.status_code == 503 else None


def any_answer(
    step: Mapping[str, Any], random: np.random.Generator, person: MadeUpPerson | None = None
) -> dict[str, Any]:
    """A valid answer to any step without drives, as the API tells it to bots. Without a made-up person, bots have no
    opinion on anything but drives."""
    if step["kind"] == "guess":
        return {"choice": "ab"[int(random.integers(2))]}
    if step["kind"] == "attention":
        return {"choice": step["instructed"]}
    if step["kind"] == "consent":
        return {"given": True, "purposes": dict.fromkeys(step.get("purposes", ()), True)}
    answers: dict[str, Any] = {}
    for item in step.get("items", []):
        value = _value(item, step.get("block"), random, person)  # drawn in any case, so that bots stay comparable
        if all(ItemWhen.model_validate(one).fits(answers.get(one["item"])) for one in item.get("when", ())):
            answers[item["key"]] = value
    return answers


def _value(
    item: Mapping[str, Any], condition: str | None, random: np.random.Generator, person: MadeUpPerson | None
) -> Any:
    if item.get("answer") is not None:  # a comprehension or attention check
        return int(item["answer"]) if item["type"] == "scale" else item["answer"]
    options = [option["value"] for option in item.get("options", [])]
    if item["type"] == "scale":
        return (
            person.rate(item["key"], condition, item["points"])
            if person
            else int(random.integers(1, item["points"] + 1))
        )
    if item["type"] == "ranking":
        return person.rank(item["key"], options) if person else [options[k] for k in random.permutation(len(options))]
    if item["type"] == "choice":
        return options[int(random.integers(len(options)))]
    if item["type"] == "number":
        low = item["min"] if item["min"] is not None else 0
        high = item["max"] if item["max"] is not None else low + 100
        return int(random.integers(low, high + 1))
    return "simulated"


def simulate_study(
    base_url: str,
    recruiting_token: str,
    participants: int,
    character: Character | None = None,
    *,
    client: httpx.Client | None = None,
) -> dict[str, Any]:
    """Walk `participants` bots one after another through the study behind the recruiting link.

    client: for tests, one that reaches the application without a network.
    Returns what `walk_all` does. Raises LearningError for an unknown oracle, BotError if the server does not let a bot
    go on.
    """
    own = client or httpx.Client(base_url=base_url, timeout=60.0)
    try:
        return walk_all((HttpWay(own, recruiting_token) for _ in range(participants)), character or Character())
    finally:
        if client is None:
            own.close()


def walk_all(ways: Iterable[Way], character: Character) -> dict[str, Any]:
    """One bot per way, one after another.

    Returns {"participants", "completed", "responses", "comparisons", "codes", "seconds"}. Raises as `simulate_study`.
    """
    character.check()  # before anybody joins
    began = time.monotonic()
    walks = [Bot(way, character, number).walk() for number, way in enumerate(ways)]
    return {
        "participants": len(walks),
        "completed": sum(walk.completed for walk in walks),
        "responses": sum(walk.responses for walk in walks),
        "comparisons": sum(walk.comparisons for walk in walks),
        "codes": [walk.participant for walk in walks],
        "seconds": round(time.monotonic() - began, 2),
    }


class Bot:
    """One simulated participant."""

    def __init__(self, way: Way, character: Character, number: int) -> None:
        self._way, self._cohort = way, character.cohort
        self._random = np.random.default_rng([character.seed, number, 11])
        self._person = character.cohort.person(number) if character.cohort else None
        stream = int(self._random.integers(2**31))
        self._usual = character.taste(number)
        names = {self._usual, *(character.cohort.preferences.values() if character.cohort else ())}
        response_model = asdict(character.response_model)
        self._oracles: dict[str, Oracle] = {name: make_oracle(name, **response_model, seed=stream) for name in names}
        self._style, self._number = character.style, number
        self._participant = way.join(character.told(number))
        self._responses = self._comparisons = 0

    def walk(self) -> Walk:
        """From the first page to the last."""
        state = self._way.state()
        stood_since = time.monotonic()
        while state["state"] == "active" or state["step"]["kind"] == "appointment":
            step = state["step"]
            if step["kind"] == "appointment":
                state = self._way.come_back()
                continue
            if step["kind"] == "wait":
                if time.monotonic() - stood_since > PATIENCE_S:
                    raise BotError(f"participant {self._participant} waited {PATIENCE_S:.0f} s at step {step['key']!r}")
                time.sleep(POLL_S)
                state = self._way.state()
                continue
            if step["kind"] in DRAWN_KINDS:
                value = self._drawn(step)
            else:
                value = self._watched(step) if step["trial"] else any_answer(step, self._random, self._person)
            state = self._way.submit(step["key"], value)
            self._responses += not state["duplicate"]
            stood_since = time.monotonic()
        return Walk(self._participant, state["state"] == "completed", self._responses, self._comparisons)

    def _watched(self, step: Mapping[str, Any]) -> dict[str, Any]:
        """The way a page goes: start, A seen, B seen, then the choice between the two drives."""
        state = self._way.start(step["key"])
        if step["kind"] in SINGLE_KINDS:
            self._way.seen(step["key"], "a", state["step"]["trial"]["playback_id"])
            return {}
        for drive in ("a", "b"):
            state = self._way.seen(step["key"], drive, state["step"]["trial"]["playback_id"])
        self._comparisons += step["kind"] == "comparison"
        return {"choice": "ab"[self._choice(step, *self._way.drives())]}

    def _drawn(self, step: Mapping[str, Any]) -> dict[str, Any]:
        """A path in the bot's style, drawn again where it touches something, then kept.

        Where a walk has to be chosen, any of them; where the participant walks, a walk to any free place.
        """
        from backend.demonstrations.demonstrators import STYLES, draw_stroke  # numba comes with it

        style = self._style or list(STYLES)[self._number % len(STYLES)]
        scenes = [Scene.from_dict(one) for one in step["scenes"]]
        told: Any = None
        for _ in range(DRAWING_TRIES):
            choice = int(self._random.integers(len(scenes))) if len(scenes) > 1 else 0
            stroke = draw_stroke(style, scenes[choice], int(self._random.integers(2**31)))
            state = self._way.draw(step["key"], stroke.as_dict() | {"pointer": "bot", "walk": choice})
            if state["step"]["trial"]["walking"]:
                state = self._walked(step["key"], scenes[choice], state["step"]["trial"])
            told = state.get("problem")
            if told is None:
                return {"stroke": state["step"]["trial"]["stroke"]}
        raise BotError(f"participant {self._participant}: {DRAWING_TRIES} paths were refused, the last one: {told}")

    def _walked(self, key: str, scene: Scene, shown: Mapping[str, Any]) -> State:
        from backend.demonstrations.planned_walks import record_walk  # numba comes with it

        times, poses = record_walk(scene, shown["duration_s"], int(self._random.integers(2**31)))
        walk = {"times_s": times.tolist(), "poses": poses.tolist()}
        return self._way.walked(key, shown["playback_id"], walk)

    def _choice(self, step: Mapping[str, Any], a: Trajectory, b: Trajectory) -> int:
        """The taste's, then what the cohort makes of it. 0 for A, 1 for B."""
        condition, query, role = str(step.get("block")), str(step.get("query")), str(step.get("role"))
        taste = self._cohort.preferences.get(condition, self._usual) if self._cohort else self._usual
        choice = self._oracles[taste].choose(Query(a.scene, a, b, (0, 1)))
        if self._person is None or step["kind"] == "comparison":
            return choice
        if self._person.takes_second(condition, query, role):
            return 1
        return choice ^ self._person.slips(condition, query, role)


class HttpWay:
    """Over HTTP, as a page would."""

    def __init__(self, client: httpx.Client, recruiting_token: str, language: str = "en") -> None:
        self._client, self._link, self._language, self._api = client, recruiting_token, language, ""
        self.token = ""

    def join(self, told: Mapping[str, Any]) -> str:
        body = {"simulated": True, "language": self._language, "oracle": dict(told)}
        joined = self._post(f"/join/{self._link}", body)
        self.token = str(joined["token"])
        self._api = f"/api/session/{self.token}"
        return str(joined["participant"])

    def come_back(self) -> State:
        self.token = next_token(self.token)
        self._api = f"/api/session/{self.token}"
        return self.state()

    def state(self) -> State:
        return self._answered("GET", self._api)

    def start(self, key: str) -> State:
        return self._post(f"{self._api}/trials/{key}/start", {"request_id": uuid4().hex})

    def seen(self, key: str, side: str, playback_id: str) -> State:
        return self._post(f"{self._api}/trials/{key}/seen", {"side": side, "playback_id": playback_id})

    def drives(self) -> tuple[Trajectory, Trajectory]:
        told = self._answered("GET", f"{self._api}/trial-data")
        a, b = (Trajectory.from_bytes(base64.b64decode(told[name])) for name in ("a", "b"))
        return a, b

    def draw(self, key: str, stroke: Mapping[str, Any]) -> State:
        return self._post(f"{self._api}/drawing/{key}/stroke", {"request_id": uuid4().hex, **stroke})

    def walked(self, key: str, playback_id: str, walk: Mapping[str, Any]) -> State:
        return self._post(f"{self._api}/drawing/{key}/driven", {"playback_id": playback_id, "walk": dict(walk)})

    def submit(self, key: str, value: Mapping[str, Any]) -> State:
        return self._post(f"{self._api}/steps/{key}", {"request_id": uuid4().hex, "value": dict(value)})

    def _post(self, path: str, body: dict[str, Any]) -> dict[str, Any]:
        return self._answered("POST", path, body)

    def _answered(self, method: str, path: str, body: dict[str, Any] | None = None) -> dict[str, Any]:
        response = self._client.request(method, path, json=body)
        for _ in range(BUSY_TRIES):
            wait_s = put_off_s(response)
            if wait_s is None:
                break
            time.sleep(wait_s)
            response = self._client.request(method, path, json=body)
        if response.is_success:
            answered: dict[str, Any] = response.json()
            return answered
        asked = response.request.url.path.rsplit("/", 1)[-1]
        raise BotError(f"the server refused {asked!r} with {response.status_code}: {response.text[:300]}")
