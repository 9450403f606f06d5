"""Simulated participants over HTTP, as a page would reach the server."""

from __future__ import annotations

import base64
import time
from collections.abc import Mapping, Sequence
from typing import Any
from uuid import uuid4

import httpx

from desirepath.simulation.trajectory import Trajectory
from desirepath.store.sides import Side
from desirepath.study.links import next_token
from desirepath.study.simulated.participant import (
    SIMULATED_HEADSET,
    Character,
    SaidMark,
    SimulationError,
    State,
    walk_all,
)

BUSY_TRIES = 20  # of a request that a busy server put off (503); nothing of it was stored, so it is simply sent again


def put_off_s(response: httpx.Response) -> float | None:
    """How long a busy server asks to wait before the same request is sent again; None: it has answered."""
    return float(response.headers.get("Retry-After", 1)) if response.status_code == 503 else None


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
    Returns what `walk_all` does. Raises LearningError for an unknown oracle, SimulationError if the server does not
    let one go on.
    """
    own = client or httpx.Client(base_url=base_url, timeout=60.0)
    try:
        return walk_all(
            (HttpSessionClient(own, recruiting_token) for _ in range(participants)), character or Character()
        )
    finally:
        if client is None:
            own.close()


class HttpSessionClient:
    """Over HTTP, as a page would."""

    def __init__(self, client: httpx.Client, recruiting_token: str, language: str = "en") -> None:
        self._client, self._link, self._language, self._api = client, recruiting_token, language, ""
        self.token = ""

    def join(self, character: Mapping[str, Any]) -> str:
        body = {"simulated": True, "language": self._language, "oracle": dict(character)}
        joined = self._post(f"/join/{self._link}", body)
        self.token = str(joined["token"])
        self._api = f"/api/session/{self.token}"
        return str(joined["participant"])

    def come_back(self) -> State:
        self.token = next_token(self.token)
        self._api = f"/api/session/{self.token}"
        return self.state()

    def state(self) -> State:
        return self._request("GET", self._api)

    def start(self, key: str) -> State:
        return self._post(f"{self._api}/trials/{key}/start", {"request_id": uuid4().hex})

    def report_seen(
        self, key: str, side: Side, playback_id: str, *, worn: bool = False, marks: Sequence[SaidMark] = ()
    ) -> State:
        body = {"side": side, "playback_id": playback_id, "headset": dict(SIMULATED_HEADSET) if worn else None}
        return self._post(f"{self._api}/trials/{key}/seen", body)

    def trajectories(self) -> list[Trajectory]:
        answered = self._request("GET", f"{self._api}/trial-data")
        return [Trajectory.from_bytes(base64.b64decode(one)) for one in answered["shown"]]

    def draw(self, key: str, stroke: Mapping[str, Any]) -> State:
        return self._post(f"{self._api}/drawing/{key}/stroke", {"request_id": uuid4().hex, **stroke})

    def report_walk(self, key: str, playback_id: str, walk: Mapping[str, Any]) -> State:
        return self._post(f"{self._api}/drawing/{key}/rollout-seen", {"playback_id": playback_id, "walk": dict(walk)})

    def submit(self, key: str, value: Mapping[str, Any]) -> State:
        return self._post(f"{self._api}/steps/{key}", {"request_id": uuid4().hex, "value": dict(value)})

    def _post(self, path: str, body: dict[str, Any]) -> dict[str, Any]:
        return self._request("POST", path, body)

    def _request(self, method: str, path: str, body: dict[str, Any] | None = None) -> dict[str, Any]:
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
        endpoint = response.request.url.path.rsplit("/", 1)[-1]
        raise SimulationError(f"the server refused {endpoint!r} with {response.status_code}: {response.text[:300]}")
