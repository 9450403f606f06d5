"""Installations that may be broken: a data folder with a study, served by real processes, and who takes part in it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

import httpx
import msgspec
import numpy as np
import websockets
from sqlalchemy import select
from websockets.sync.client import ClientConnection
from websockets.sync.client import connect as connect_websocket

from desirepath.cli.loopback import loopback_server
from desirepath.settings import Settings
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.models import Event, Response, Session, Study, Trial
from desirepath.store.shipped_policies import register_shipped
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.session.finding import token_hash
from desirepath.study.simulated.participant import any_answer
from desirepath.study.studies import create_study
from desirepath.web.core.auth import ensure_first_user
from desirepath_experiments.benchmarks.open_browser import CAMERA
from desirepath_stage.viser_hooks import SUBPROTOCOL, readable_part
from tests.running import PATIENCE_S
from tests.study.walking import QUICK, VALUES, twenty_queries

HEARD_S = 60.0


class Installation:
    """A data folder of its own with one open study. `serving` runs the product over it, as often as it is killed."""

    def __init__(self, data: Path, database_url: str | None = None) -> None:
        self.settings = Settings(data=data, database_url=database_url, artefacts_url=None, _env_file=None)
        self.database = Database(self.settings.database)
        self.database.migrate()
        self.files = ArtefactStore(self.settings.artefacts)
        protocol = QUICK.read_text().replace("study_room/queries_varied_200", str(twenty_queries(data)))
        with self.database.transaction() as s:
            register_shipped(s, self.files)
            self.study: Study = create_study(s, self.files, freeze_text(protocol), name="Faults", created_by=None)
        self.password = ensure_first_user(self.database, must_change=False)

    @contextmanager
    def serving(self, *, worker: bool = False, processes: int = 1) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
        """One life of `desirepath serve`: its address and its process."""
        arguments = ("--processes", str(processes))
        with loopback_server(self.settings, worker=worker, arguments=arguments) as (url, process):
            yield url, process

    def session(self, token: str) -> Session:
        with self.database.session() as s:
            return s.scalars(select(Session).where(Session.token_hash == token_hash(token))).one()

    def refusals(self, code: str) -> list[Event]:
        """What the log says was refused with that code."""
        return [event for event in self.events("refused") if event.data["code"] == code]

    def events(self, kind: str) -> list[Event]:
        with self.database.session() as s:
            return list(s.scalars(select(Event).where(Event.kind == kind).order_by(Event.id)))

    def responses(self, token: str) -> list[Response]:
        session = self.session(token)
        with self.database.session() as s:
            return list(s.scalars(select(Response).where(Response.session_id == session.id)))

    def trial(self, token: str, step: str) -> Trial:
        session = self.session(token)
        with self.database.session() as s:
            return s.scalars(select(Trial).where(Trial.session_id == session.id, Trial.step_key == step)).one()


class Visitor:
    """A participant's browser without the picture. A person by default; a bot may skip the watching."""

    def __init__(self, url: str, study: Study, *, bot: bool = False) -> None:
        self.browser = httpx.Client(base_url=url, timeout=60.0)
        self.random = np.random.default_rng(5)
        joined = self.browser.post(
            f"/join/{study.recruiting_token}", json={"simulated": bot, "language": "en", "oracle": {"name": "random"}}
        )
        self.token: str = joined.json()["token"]
        self.api = f"/api/session/{self.token}"

    def move_to(self, url: str) -> None:
        """The same address answers again; here it has another port."""
        self.browser.base_url = httpx.URL(url)

    def state(self) -> dict[str, Any]:
        found: dict[str, Any] = self.browser.get(self.api).json()
        return found

    def open_page(self) -> httpx.Response:
        return self.browser.get(f"/p/{self.token}")

    def post(self, where: str, **body: object) -> httpx.Response:
        return self.browser.post(f"{self.api}/{where}", json=body)

    def answer(self, step: str, value: object, request_id: str | None = None) -> httpx.Response:
        return self.post(f"steps/{step}", request_id=request_id or uuid4().hex, value=value)

    def walk_to_first_trial(self) -> dict[str, Any]:
        """Answer everything before it; returns the trial's step."""
        step: dict[str, Any] = self.state()["step"]
        while not step["trial"]:
            value = any_answer(step, self.random) if "items" in step else VALUES[step["key"]]
            answered = self.answer(step["key"], value)
            assert answered.status_code == 200, answered.text
            step = answered.json()["step"]
        return step

    def watch(self, step: str) -> None:
        """Go through both drives of a trial as a bot may: at once."""
        state = self.post(f"trials/{step}/start").json()
        for side in ("a", "b"):
            shown = state["step"]["trial"]["playback_id"]
            state = self.post(f"trials/{step}/seen", side=side, playback_id=shown).json()

    @contextmanager
    def stage(self, *, token: str | None = None, origin: str | None = None) -> Iterator[ClientConnection]:
        """The websocket behind the stage's door, with the cookies of this browser."""
        address = httpx.URL(self.state()["stage_url"])
        with connect_websocket(
            f"ws://{address.netloc.decode()}/stage/{token or stage_token_of(self)}",
            origin=websockets.Origin(origin or f"http://{address.netloc.decode()}"),
            subprotocols=[websockets.Subprotocol(SUBPROTOCOL)],
            additional_headers={"Cookie": "; ".join(f"{c.name}={c.value}" for c in self.browser.cookies.jar)},
            compression=None,
            max_size=None,
        ) as socket:
            socket.send(msgspec.msgpack.encode(CAMERA))
            yield socket


class Bot:
    """Answers pairs on a thread of its own; what was not acknowledged is sent again under the same request id.

    find: how it gets back to a server after its connection broke.
    """

    def __init__(self, visitor: Visitor, pairs: int, find: Callable[[Visitor], None]) -> None:
        self.visitor, self.pairs, self.find = visitor, pairs, find
        self.tries = 0
        self.acknowledged: dict[str, str] = {}  # request id -> step, of answers to pairs
        self.sent_again: list[dict[str, Any]] = []  # what the server said to answers sent more than once

    def walk(self) -> None:
        step = self._until_served(self.visitor.walk_to_first_trial)["key"]
        while len(self.acknowledged) < self.pairs:
            self._until_served(self._watch, step)
            request_id, tries = uuid4().hex, self.tries
            answered = self._until_served(self.visitor.answer, step, {"choice": "a"}, request_id)
            assert answered.status_code == 200, answered.text
            if self.tries > tries + 1:
                self.sent_again.append(answered.json())
            self.acknowledged[request_id] = step
            step = answered.json()["step"]["key"]

    def _watch(self, step: str) -> None:
        if self.visitor.state()["step"]["trial"]["phase"] != "choosing":  # the server died after it knew of both drives
            self.visitor.watch(step)

    def _until_served(self, ask: Callable[..., Any], *about: Any) -> Any:
        deadline = time.monotonic() + PATIENCE_S
        while True:
            self.tries += 1
            try:
                return ask(*about)
            except httpx.TransportError:
                assert time.monotonic() < deadline, "the server did not come back"
                self.find(self.visitor)


def stage_token_of(visitor: Visitor) -> str:
    """The token in the address of a visitor's stage."""
    address: str = visitor.state()["stage_url"]
    return address.rstrip("/").rpartition("/")[2]


def hear(socket: ClientConnection, words: str) -> None:
    """Listen until the stage is told that."""
    while words.encode() not in readable_part(socket.recv(HEARD_S)):
        pass


def run_command(*arguments: str, data: Path) -> subprocess.CompletedProcess[str]:
    """Run `desirepath ARGUMENTS` in a process of its own over that data folder."""
    return subprocess.run(
        [sys.executable, "-m", "desirepath", *arguments],
        env={**os.environ, "DESIREPATH_DATA": str(data)},
        capture_output=True,
        text=True,
        timeout=120,
    )
