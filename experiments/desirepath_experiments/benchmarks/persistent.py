"""Simulated participants who do not give up: what a server that dies did not acknowledge they send again."""

from __future__ import annotations

import threading
import time
from typing import Any
from uuid import uuid4

import httpx
import numpy as np

from desirepath.study.links import token_hash
from desirepath.study.simulated.http import put_off_s
from desirepath.study.simulated.participant import any_answer

PAIRS = 12  # of one session; then the same thread joins as somebody else
PATIENCE_S = 90.0
AGAIN_AFTER_S = 0.1


class Gone(RuntimeError):
    """The server did not answer for too long, or refused what it may not refuse."""


class WatchAgain(RuntimeError):
    """The database lost where in a trial somebody was: the trial starts over, as the page shows it then."""


class Persistent:
    """Joins, answers pairs, joins again, until told to stop. acknowledged: request id -> (hash of the session's token,
    step, choice), of answers to pairs; watched_again: pairs that were seen and started over; problem: why it could not
    go on."""

    def __init__(self, address: str, link: str, seed: int, stopping: threading.Event) -> None:
        self._client = httpx.Client(base_url=address, timeout=20.0)
        self._link, self._stopping = link, stopping
        self._random = np.random.default_rng([seed, 23])
        self.acknowledged: dict[str, tuple[str, str, str]] = {}
        self.acknowledged_at: list[float] = []  # by `time.monotonic`
        self.sent_again = self.watched_again = 0
        self.problem = self.last = ""

    def walk(self) -> None:
        """For a thread of its own."""
        try:
            while not self._stopping.is_set():
                self._take_part()
        except Exception as problem:
            self.problem = f"{type(problem).__name__}: {problem}"
        finally:
            self._client.close()

    def _take_part(self) -> None:
        joining = {"simulated": True, "language": "en", "oracle": {"name": "random", "noise": 0.0, "seed": 0}}
        token = self._ask("POST", f"/join/{self._link}", joining)["token"]
        api = f"/api/session/{token}"
        step = self._ask("GET", api)["step"]
        answered = 0
        while answered < PAIRS and not self._stopping.is_set():
            if step["trial"]:
                self._watch(api, step["key"])
                choice = "ab"[int(self._random.integers(2))]
                request_id = uuid4().hex
                try:
                    state = self._submit(api, step["key"], {"choice": choice}, request_id)
                except WatchAgain:
                    self.watched_again += 1
                    continue
                self.acknowledged[request_id] = (token_hash(token), step["key"], choice)
                self.acknowledged_at.append(time.monotonic())
                answered += 1
            else:
                state = self._submit(api, step["key"], any_answer(step, self._random), uuid4().hex)
            step = state["step"]

    def _watch(self, api: str, key: str) -> None:
        """Both trajectories; whatever the server forgot of it is watched once more."""
        deadline = time.monotonic() + PATIENCE_S
        while (trial := self._ask("GET", api)["step"]["trial"])["phase"] != "choosing":
            if time.monotonic() > deadline:
                raise Gone(f"{key} cannot be watched: {trial['phase']}")
            trial_path = f"{api}/trials/{key}"
            if trial["playback_id"]:
                side = "a" if trial["phase"] == "playing_a" else "b"
                self._ask(
                    "POST", f"{trial_path}/seen", {"side": side, "playback_id": trial["playback_id"]}, may_refuse=True
                )
            else:
                self._ask("POST", f"{trial_path}/start", {"request_id": uuid4().hex}, may_refuse=True)

    def _submit(self, api: str, key: str, value: dict[str, Any], request_id: str) -> dict[str, Any]:
        return self._ask("POST", f"{api}/steps/{key}", {"request_id": request_id, "value": value})

    def _ask(self, method: str, path: str, body: object = None, *, may_refuse: bool = False) -> dict[str, Any]:
        deadline = time.monotonic() + PATIENCE_S
        while True:
            response, wait_s = None, AGAIN_AFTER_S
            try:
                response = self._client.request(method, path, json=body)
                self.last = f"{response.status_code} to {path.rsplit('/', 1)[-1]}: {response.text[:120]}"
            except httpx.TransportError as problem:
                self.last = f"{type(problem).__name__} at {path.rsplit('/', 1)[-1]}"
            if response is not None:
                if response.is_success or (may_refuse and response.status_code == 409):
                    answered: dict[str, Any] = response.json()
                    return answered
                if response.status_code == 409 and response.json()["error"]["code"] == "too_early":
                    raise WatchAgain(self.last)
                if response.status_code not in (503, 507):
                    raise Gone(self.last)
                wait_s = min(put_off_s(response) or AGAIN_AFTER_S, 1.0)
            if time.monotonic() > deadline:
                raise Gone(f"for {PATIENCE_S:.0f} s: {self.last}")
            self.sent_again += 1
            time.sleep(wait_s)
