"""Who may open a session's stage, and what a session's stream tells its page."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator
from types import SimpleNamespace

import pytest
from sqlalchemy import select
from starlette.requests import Request

from desirepath.store.models import Event, Session, Study, Trial
from desirepath.study.session import machine
from desirepath.web.application import create_application
from desirepath.web.core.dependencies import Services
from desirepath.web.participant.stream import stream
from desirepath.web.stage.admission import stage_cookie, stage_token
from tests.study import walking


@pytest.fixture
def walker(services: Services) -> walking.Walker:
    with services.database.session() as s:
        study = s.scalars(select(Study).where(Study.name == "Short")).one()
    return walking.Walker(services.database, services.files, study)


def admit(services, token, cookies):
    return asyncio.run(services.admission.admit(token, cookies, None))


def codes(services):
    with services.database.session() as s:
        return [event.data["code"] for event in s.scalars(select(Event).where(Event.kind == "refused"))]


def test_token_and_cookie_of_the_same_session_open_its_stage(services, walker):
    grant = admit(services, stage_token(walker.session), dict([stage_cookie(walker.session)]))
    assert grant is not None
    assert grant.key == walker.session.id
    assert walker.session.participant_id not in stage_token(walker.session)
    assert walker.token not in stage_token(walker.session)


def test_a_forged_foreign_or_copied_address_opens_nothing_and_is_logged(services, walker):
    other = walking.Walker(services.database, services.files, _study(services))
    cookie = dict([stage_cookie(walker.session)])
    assert admit(services, f"{walker.session.id}.{'0' * 40}", cookie) is None
    assert admit(services, "nobody.0", cookie) is None
    assert admit(services, stage_token(walker.session), {}) is None  # the address was copied
    assert admit(services, stage_token(other.session), cookie) is None  # somebody else's
    assert codes(services) == ["forged_stage", "unknown_stage", "stage_without_cookie", "stage_without_cookie"]


def test_the_stage_of_a_session_that_has_ended_stays_closed(services, walker):
    walker.do(machine.withdraw, now=walker.now)
    assert admit(services, stage_token(walker.session), dict([stage_cookie(walker.session)])) is None
    assert codes(services) == ["stage_of_ended_session"]


class Recorder:
    """A stage that writes down what it is asked for; the real one is driven in tests/app and tests/journeys."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def show(self, scene, view, *, trajectories=(), explained=None, halted=False, goal=False):
        assert explained is None
        assert not halted
        self.asked.append(f"show {view} {scene.setup} {len(trajectories)}")

    def clear(self):
        self.asked.append("clear")


def test_a_stage_that_connects_shows_the_trial_and_puts_it_back_to_its_start(services, walker):
    stage = Recorder()
    services.presenter.on_connect(stage, walker.session.id)
    assert stage.asked == ["clear"]  # no trial yet
    walker.walk_to("block.01")
    walker.do(machine.start_trial, "block.01", request_id=None, now=walker.now)
    services.presenter.on_connect(stage, walker.session.id)
    assert stage.asked[1:] == ["show top_down study_room 2"]
    with services.database.session() as s:
        trial = s.scalars(select(Trial)).one()
        event = s.scalars(select(Event).where(Event.kind == "trial_interrupted")).one()
    assert (trial.phase, trial.restarts) == ("ready", 1)
    assert event.data["reason"] == "stage_connected"


def test_the_stream_tells_of_changes_and_of_another_window(services, walker):
    async def page() -> list[tuple[str, dict]]:
        listeners, events = services.listeners, await events_of(services, walker.token)
        told = [parsed(await anext(events))]
        await asyncio.to_thread(walker.submit, "information", {})
        listeners.tell_changed(walker.session.id)
        told.append(parsed(await anext(events)))
        listeners.listen(walker.session.id)  # a second window
        told.append(parsed(await anext(events)))
        assert [one async for one in events] == []
        return told

    assert asyncio.run(page()) == [("state", {}), ("state", {}), ("moved", {"reason": "other_window"})]


def test_the_stream_tells_the_jobs_progress_while_somebody_waits(services, walker):
    walker.walk_to("train.wait")

    async def page() -> list[tuple[str, dict]]:
        events = await events_of(services, walker.token)
        return [parsed(await anext(events)) for _ in range(2)]

    assert asyncio.run(page()) == [
        ("state", {}),
        ("job", {"progress": 0.0, "before": 0, "running": False, "seconds": None, "at_most": 120, "done": False}),
    ]


async def events_of(services: Services, token: str) -> AsyncIterator[str]:
    """What the session's stream sends to a page that opens it."""
    request = Request({"type": "http", "app": create_application(services)})
    return (await stream(token, request)).body_iterator


def parsed(event: str) -> tuple[str, dict]:
    name, data = event.strip().split("\n")
    return name.removeprefix("event: "), json.loads(data.removeprefix("data: "))


def _study(services):
    with services.database.session() as s:
        return s.scalars(select(Study).where(Study.name == "Short")).one()


def test_nobody_waits_for_a_trajectory_whose_order_was_lost(services, walker):
    """Whatever goes wrong on the way to the stage: the trial starts over, the page hears of it, the scene stands."""
    walker.walk_to("block.01")
    played = walker.do(machine.start_trial, "block.01", request_id=None, now=walker.now)

    class Failing(Recorder):
        def play(self, trajectory, **how):
            raise RuntimeError("deque mutated during iteration")

    stage = Failing()
    services.presenter.server = SimpleNamespace(stage=lambda key: stage)

    async def page() -> bool:
        listener = services.listeners.listen(walker.session.id)
        services.presenter.play(walker.session.id, played)
        await asyncio.wait_for(listener.wait(60), 10)
        return True

    assert asyncio.run(page())
    services.presenter.on_connect(Recorder(), "nobody")  # waits for its turn behind what was ordered before
    with services.database.session() as s:
        trial = s.scalars(select(Trial)).one()
        event = s.scalars(select(Event).where(Event.kind == "trial_interrupted")).one()
    assert (trial.phase, event.data["reason"]) == ("ready", "stage_failed")
    deadline = time.monotonic() + 10
    while stage.asked[-2:] != ["clear", "show top_down study_room 2"]:  # put back on a thread of its own
        assert time.monotonic() < deadline, stage.asked
        time.sleep(0.01)


def test_a_session_is_never_shown_to_a_key_that_is_none(services):
    stage = Recorder()
    services.presenter.on_connect(stage, "nobody")
    assert stage.asked == []
    with services.database.session() as s:
        assert s.scalars(select(Session)).first() is None
