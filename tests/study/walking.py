"""Walks sessions at the pace of a clock of its own, so that no test waits for drives."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

from sqlalchemy import select

from desirepath.learning.policies.shipped import load_queries
from desirepath.learning.queries.queries import QuerySet
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.models import Response, Session, Study, utc_now
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.session import machine
from desirepath.study.session.finding import acting
from desirepath.study.session.joining import join_study
from desirepath.study.studies import create_study

QUICK = Path(__file__).resolve().parents[2] / "study_protocols" / "quick_preference_study.yaml"
INSTANT = (
    QUICK.read_text()
    .replace("recipe: each_scene", "recipe: instant")
    .replace("scenes: 6, blind", "scenes: 3, blind")
    .replace(", preferred: 5", "")
)
"""The shipped protocol with one policy for all scenes, refined behind it, and three comparisons."""
DEMOGRAPHICS = {"age": 44, "gender": "woman", "vision": "normal", "vr_experience": 1, "robotics_experience": 3}
ITEMS = [
    *("ease", "confidence", "mental_effort", "clarity", "naturalness"),
    *("spatial_understanding", "realism", "presence", "fun", "boredom"),
]
VALUES = {
    "information": {},
    "consent": {"given": True, "version": "2026-11"},
    "demographics": DEMOGRAPHICS,
    "instruction": {},
    "train.interface_items": dict.fromkeys(ITEMS, 4),
}
GIVEN = {"given": True, "version": "1"}
"""The answer to the consent of `small_protocol.py`."""


def twenty_queries(folder: Path) -> Path:
    """A query set of 20 of the shipped queries, so that no test stores four hundred drives."""
    shipped = load_queries("study_room/queries_500")
    path = folder / "twenty.npz"
    QuerySet(shipped.setup, shipped.queries[:20], {}).save(path)
    return path


def furnish(folder: Path, queries: Path) -> None:
    """Make `folder` a data folder with three studies: "Short" asks three queries, "Full" asks fifteen, both drawn
    at random and with one alignment; "Instant" is short, and as `INSTANT`."""
    database = Database(f"sqlite:///{folder / 'desirepath.sqlite'}")
    database.migrate()
    files = ArtefactStore((folder / "artefacts").as_uri())
    instant = INSTANT.replace("study_room/queries_varied_200", str(queries))
    full = instant.replace("recipe: instant", "recipe: fine_tuning").replace("choose: information", "choose: random")
    few = ("count: 15", "count: 3")
    texts = {"Full": full, "Short": full.replace(*few), "Instant": instant.replace(*few)}
    with database.transaction() as s:
        for name, text in texts.items():
            create_study(s, files, freeze_text(text), name=name, created_by=None)
    database.close()


class Walker:
    """One session; `now` is its clock."""

    def __init__(self, database: Database, files: ArtefactStore, study: Study, *, simulated: bool = False) -> None:
        self.database, self.files = database, files
        with database.transaction() as s:
            self.session, self.token = join_study(s, study, language="en", simulated=simulated, files=files)
        self.now = utc_now()
        self.requests = 0

    def do(self, action: Callable[..., object], *arguments: object, **named: object) -> object:
        """One request: `action(s, session, ...)` in its own transaction."""
        with acting(self.database, self.token, request=action.__name__, now=self.now) as (s, session):
            return action(s, session, *arguments, **named)

    def submit(self, key: str, value: dict, *, request_id: str | None = None) -> machine.Submitted:
        self.requests += 1
        request_id = request_id or f"{self.session.id}-{self.requests}"
        with acting(self.database, self.token, request="submit", now=self.now) as (s, session):
            return machine.submit(
                s, self.files, session, key, value, request_id=request_id, client_time=self.now, now=self.now
            )

    def later(self, seconds: float) -> datetime:
        self.now += timedelta(seconds=seconds)
        return self.now

    @property
    def view(self) -> machine.StepView:
        with self.database.session() as s:
            return machine.current(s, s.get_one(Session, self.session.id), now=self.now)

    def watch(self, key: str, drives: str = "ab") -> None:
        """Start the trial and see both drives, or A alone, to their ends."""
        play = self.do(machine.start_trial, key, request_id=None, now=self.now)
        for drive in drives:
            self.later(2.0 + self.view.trial[f"duration_{drive}_s"] + 0.1)
            play = self.do(machine.trajectory_seen, key, drive, play.playback_id, now=self.now)

    def walk_to(self, key: str) -> None:
        """Answer everything before the step `key`."""
        while (view := self.view).key != key:
            if view.kind in ("trial", "comparison"):
                self.watch(view.key)
                self.later(1.0)  # who chooses at once, or always the same letter, teaches nothing
                self.submit(view.key, {"choice": "ab"[view.index % 2]})
            else:
                self.submit(view.key, VALUES[view.key])


def session_row(walker: Walker) -> Session:
    """The walker's session as it stands in the database."""
    with walker.database.session() as s:
        return s.get_one(Session, walker.session.id)


def answer(walker: Walker, key: str) -> Response:
    """The one answer to that step."""
    with walker.database.session() as s:
        return s.scalars(select(Response).where(Response.step_key == key)).one()
