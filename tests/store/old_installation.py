"""An installation of before the rooms were rebuilt (`old/README.md`), and somebody who goes on with a session of it."""

from __future__ import annotations

import json
import shutil
import tarfile
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import select

from desirepath.simulation.scene import Scene
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.models import Job, Session
from desirepath.store.outbox import ENDED, cancel_job
from desirepath.study.drawing import strokes
from desirepath.study.kinds.demonstration import drawing_of
from desirepath.study.links import next_token, token_hash
from desirepath.study.session import leaving, machine, watching
from desirepath.study.session.finding import acting
from desirepath.study.simulated.known import known_to_simulated
from desirepath.study.simulated.participant import any_answer
from tests.study.walking import Walker

PACKED = Path(__file__).parent / "old" / "installation.tar.xz"
MOST_STEPS = 200


@dataclass(frozen=True)
class OldInstallation:
    """A copy of it in a folder."""

    folder: Path

    @property
    def artefacts(self) -> ArtefactStore:
        return ArtefactStore((self.folder / "artefacts").as_uri())

    @property
    def tokens(self) -> dict[str, str]:
        """Links of its sessions, by who they are."""
        found: dict[str, str] = json.loads((self.folder / "tokens.json").read_text())
        return found

    def export(self, name: str) -> Path:
        return self.folder / "exports" / name

    def copied(self, folder: Path) -> OldInstallation:
        shutil.copytree(self.folder, folder, dirs_exist_ok=True)
        return OldInstallation(folder)


def unpack(folder: Path) -> OldInstallation:
    with tarfile.open(PACKED) as packed:
        packed.extractall(folder, filter="data")
    return OldInstallation(folder)


class Returning(Walker):
    """Somebody who opens the link of a session that was begun then, a minute after they were last there."""

    def __init__(self, database: Database, files: ArtefactStore, token: str) -> None:
        self.database, self.files, self.token, self.requests = database, files, token, 0
        with database.session() as s:
            self.session = s.scalars(select(Session).where(Session.token_hash == token_hash(token))).one()
        self.now = self.session.last_seen_at + timedelta(minutes=1)
        self.random = np.random.default_rng(0)

    def submit(self, key: str, value: dict[str, Any], *, request_id: str | None = None) -> machine.Submitted:
        return super().submit(key, value, request_id=request_id or f"{self.session.id}-later-{key}")

    def state(self) -> str:
        with self.database.session() as s:
            return s.get_one(Session, self.session.id).state

    def to_the_end(self) -> list[str]:
        """Answer whatever is asked until the last appointment is over; returns the kinds of the steps met."""
        met: list[str] = []
        for _ in range(MOST_STEPS):
            if self.state() == "paused":
                self.do(leaving.resume, now=self.now)
            view = self.view
            if view.kind == "appointment":
                self._come_back()
            elif self.state() != "active":
                return met
            else:
                met.append(view.kind)
                self._answer(view)
        raise AssertionError(f"still at {self.view.key} after {MOST_STEPS} steps")

    def _come_back(self) -> None:
        self.token = next_token(self.token)
        with self.database.session() as s:
            self.session = s.scalars(select(Session).where(Session.token_hash == token_hash(self.token))).one()
        self.now = max(self.now, self.session.opens_at) + timedelta(hours=1)

    def _answer(self, view: machine.StepView) -> None:
        self.later(10)
        if view.kind == "wait":
            self._end_jobs()
            self.do(lambda s, session: machine.settle(s, self.files, session, now=self.now))
        elif view.kind == "demonstration":
            self._draw(view)
        elif view.kind == "evaluation":
            play = self.do(machine.start_trial, view.key, request_id=None, now=self.now)
            self.later(view.trial["duration_a_s"] + 3)
            self.do(machine.trajectory_seen, view.key, "a", play.playback_id, now=self.now)
            self.submit(view.key, {})
        elif view.trial is not None:
            if view.trial["phase"].startswith("playing"):  # the page of then is gone
                self.do(watching.interrupted, reason="reload", now=self.now)
            if self.view.trial["phase"] == "ready":
                self.watch(view.key)
            self.submit(view.key, {"choice": "ab"[int(self.random.integers(2))]})
        else:
            given = any_answer(self.told(view), self.random)
            # of men, the last study takes no more
            self.submit(view.key, given | ({"gender": "woman"} if "gender" in given else {}))

    def told(self, view: machine.StepView) -> dict[str, Any]:
        """The step as a bot's page has it: with the right answers of checks."""
        with acting(self.database, self.token, request="look", now=self.now) as (s, session):
            return view.as_dict() | known_to_simulated(s, session, view)

    def _end_jobs(self) -> None:
        """The worker's part: what still waits is cancelled, so that the session goes on without it."""
        with self.database.transaction() as s:
            for job in s.scalars(select(Job).where(Job.session_id == self.session.id)):
                if job.state not in ENDED:
                    cancel_job(s, job.id, by="the test's worker")

    def _draw(self, view: machine.StepView) -> None:
        if view.payload["optional"]:
            self.submit(view.key, {"skipped": True})
            return
        scene = Scene.from_dict(self.told(view)["scenes"][0])
        for height in (0.75, 1.0, 0.6, -0.75, -1.0):
            if self._drawn(view.key, scene, height):
                return
        raise AssertionError(f"{view.key}: no path that could be driven")

    def _drawn(self, key: str, scene: Scene, height: float) -> bool:
        if self.view.trial["phase"] == "drawing":
            self._stroke(key, _path(scene, height) | {"walk": 0})
        state = self.view.trial
        if state["phase"] == "drawing":
            return False  # refused
        self.later(state["duration_s"] + 3)
        if state["phase"] != "watched":
            with acting(self.database, self.token, request="driven", now=self.now) as (s, session):
                strokes.watched(s, self.files, session, drawing_of(session), state["playback_id"], None, now=self.now)
        self.submit(key, {"stroke": state["stroke"]})
        return True

    def _stroke(self, key: str, given: dict[str, Any]) -> None:
        self.requests += 1
        with acting(self.database, self.token, request="stroke", now=self.now) as (s, session):
            step = drawing_of(session)
            attempt = strokes.attempt_of(step, given, simulated=False)
            name = f"{session.id}-later-{self.requests}"
            strokes.add_stroke(s, self.files, session, step, attempt, request_id=name, client_time=None, now=self.now)


def _path(scene: Scene, height: float) -> dict[str, Any]:
    """A bow from the start to the goal."""
    along = np.linspace(0.0, 1.0, 81)
    start, goal = np.array([scene.start.x, scene.start.y]), np.array([scene.goal.x, scene.goal.y])
    across = np.array([start[1] - goal[1], goal[0] - start[0]]) / np.linalg.norm(goal - start)
    points = start + along[:, None] * (goal - start) + (height * 4 * along * (1 - along))[:, None] * across
    return {"points": points.tolist(), "speeds": [0.25] * 81, "times_s": along.tolist()}
