"""Simulated participants: programs that walk whole sessions over HTTP, as a browser would, but need not watch.

Their sessions are marked as simulated when they are created; the server lets only these be fast and read the drives.
"""

from __future__ import annotations

import base64
import time
from dataclasses import asdict, dataclass
from typing import Any
from uuid import uuid4

import httpx
import numpy as np

from backend.learning.oracles import ALWAYS_RIGHT, Habits, Oracle, make_oracle
from backend.learning.queries import Query
from backend.simulation.trajectory import Trajectory

POLL_S = 0.5  # how often a waiting bot looks
BUSY_TRIES = 20  # of a request that a busy server put off (503); nothing of it was stored, so it is simply sent again
PATIENCE_S = 900.0  # a bot gives up on a session that stands still so long; the server's own limit comes first


class BotError(OSError):
    """A session that a bot could not finish; says at which step and what the server answered."""


@dataclass(frozen=True)
class Walk:
    """What one bot did."""

    participant: str
    completed: bool
    responses: int
    comparisons: int


def put_off_s(response: httpx.Response) -> float | None:
    """How long a busy server asks to wait before the same request is sent again; None: it has answered."""
    return float(response.headers.get("Retry-After", 1)) if response.status_code == 503 else None


def any_answer(step: dict[str, Any], random: np.random.Generator) -> dict[str, Any]:
    """A valid answer to any step that is no trial, as the API tells it: bots have no opinion on anything but drives."""
    if step["kind"] == "guess":
        return {"choice": "ab"[int(random.integers(2))]}
    if step["kind"] == "consent":
        return {"given": True}
    return {item["key"]: _any_value(item, random) for item in step.get("items", [])}


def _any_value(item: dict[str, Any], random: np.random.Generator) -> Any:
    if item["type"] == "scale":
        return int(random.integers(1, item["points"] + 1))
    if item["type"] == "choice":
        return item["options"][int(random.integers(len(item["options"])))]["value"]
    if item["type"] == "number":
        low = item["min"] if item["min"] is not None else 0
        high = item["max"] if item["max"] is not None else low + 100
        return int(random.integers(low, high + 1))
    return "simulated"


def simulate_study(
    base_url: str,
    recruiting_token: str,
    participants: int,
    *,
    oracle: str = "min-human-distance",
    habits: Habits = ALWAYS_RIGHT,
    seed: int = 0,
    client: httpx.Client | None = None,
) -> dict[str, Any]:
    """Walk `participants` bots one after another through the study behind the recruiting link.

    oracle, habits, seed: the taste, how answers stray from it, and their random stream (every bot its own).
    client: for tests, one that reaches the application without a network.
    Returns {"participants", "completed", "responses", "comparisons", "seconds"}. Raises LearningError for an unknown
    oracle, BotError if the server does not let a bot go on.
    """
    make_oracle(oracle, **asdict(habits), seed=seed)  # refuse a wrong name before anybody joins
    began = time.monotonic()
    own = client or httpx.Client(base_url=base_url, timeout=60.0)
    try:
        walks = [_Bot(own, recruiting_token, oracle, habits, seed, number).walk() for number in range(participants)]
    finally:
        if client is None:
            own.close()
    return {
        "participants": participants,
        "completed": sum(walk.completed for walk in walks),
        "responses": sum(walk.responses for walk in walks),
        "comparisons": sum(walk.comparisons for walk in walks),
        "codes": [walk.participant for walk in walks],
        "seconds": round(time.monotonic() - began, 2),
    }


class _Bot:
    """One simulated participant."""

    def __init__(self, client: httpx.Client, link: str, oracle: str, habits: Habits, seed: int, number: int) -> None:
        self._client = client
        self._random = np.random.default_rng([seed, number, 11])
        self._oracle: Oracle = make_oracle(oracle, **asdict(habits), seed=int(self._random.integers(2**31)))
        told = {"name": oracle, **asdict(habits), "seed": seed, "number": number}
        joined = self._post(f"/join/{link}", {"simulated": True, "language": "en", "oracle": told})
        self._participant: str = joined["participant"]
        self._api = f"/api/session/{joined['token']}"
        self._responses = self._comparisons = 0

    def walk(self) -> Walk:
        """From the first page to the last."""
        state = self._get(self._api)
        stood_since = time.monotonic()
        while state["state"] == "active":
            step = state["step"]
            if step["kind"] == "wait":
                if time.monotonic() - stood_since > PATIENCE_S:
                    raise BotError(f"participant {self._participant} waited {PATIENCE_S:.0f} s at step {step['key']!r}")
                time.sleep(POLL_S)
                state = self._get(self._api)
                continue
            value = self._trial(step) if step["trial"] else any_answer(step, self._random)
            state = self._submit(step["key"], value)
            stood_since = time.monotonic()
        return Walk(self._participant, state["state"] == "completed", self._responses, self._comparisons)

    def _trial(self, step: dict[str, Any]) -> dict[str, Any]:
        """The way a page goes: start, A seen, B seen, then the oracle's choice between the two drives."""
        here = f"{self._api}/trials/{step['key']}"
        state = self._post(f"{here}/start", {"request_id": uuid4().hex})
        for drive in ("a", "b"):
            shown = state["step"]["trial"]["playback_id"]
            state = self._post(f"{here}/seen", {"drive": drive, "playback_id": shown})
        drives = self._get(f"{self._api}/trial-data")
        a, b = (Trajectory.from_bytes(base64.b64decode(drives[name])) for name in ("a", "b"))
        self._comparisons += step["kind"] == "comparison"
        return {"choice": "ab"[self._oracle.choose(Query(a.scene, a, b, (0, 1)))]}

    def _submit(self, key: str, value: dict[str, Any]) -> dict[str, Any]:
        state = self._post(f"{self._api}/steps/{key}", {"request_id": uuid4().hex, "value": value})
        self._responses += not state["duplicate"]
        return state

    def _get(self, path: str) -> dict[str, Any]:
        return self._answered("GET", path)

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
