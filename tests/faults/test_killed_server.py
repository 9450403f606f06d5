"""kill -9 of the server while people drive, answer and wait: nothing that was acknowledged is lost."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any
from uuid import uuid4

import httpx
import pytest

from tests.faults.installation import Installation, Visitor, hear

BOTS = 4
PAIRS = 4  # that every bot answers in both lives together
KILLED_AFTER = 6  # acknowledged answers to pairs


@dataclass
class Address:
    """Where the server is; a bot that lost it waits here for the next one."""

    url: str
    changed: threading.Event = field(default_factory=threading.Event)

    def move(self, url: str) -> None:
        self.url = url
        self.changed.set()


class Bot:
    """Answers pairs on a thread of its own and sends again, under the same request id, what was not acknowledged."""

    def __init__(self, address: Address, visitor: Visitor) -> None:
        self.address, self.visitor = address, visitor
        self.acknowledged: dict[str, str] = {}  # request id -> step, of answers to pairs
        self.sent_again: list[dict[str, Any]] = []  # what the server said to answers sent before and after the kill
        self.step = visitor.walk_to_first_trial()["key"]

    def walk(self) -> None:
        while len(self.acknowledged) < PAIRS:
            self.until_served(self.watch)
            request_id = uuid4().hex
            tries = 0

            def send(request_id: str = request_id) -> dict[str, Any]:
                nonlocal tries
                tries += 1
                answered = self.visitor.answer(self.step, {"choice": "a"}, request_id)
                if answered.status_code != 200:
                    raise AssertionError(answered.text)
                state: dict[str, Any] = answered.json()
                return state

            state = self.until_served(send)
            if tries > 1:
                self.sent_again.append(state)
            self.acknowledged[request_id] = self.step
            self.step = state["step"]["key"]

    def watch(self) -> None:
        if self.visitor.state()["step"]["trial"]["phase"] != "choosing":  # the server died after it knew of both drives
            self.visitor.watch(self.step)

    def until_served(self, ask: Callable[[], Any]) -> Any:
        """Ask; where the server is gone, wait for its next life, load the page as a browser would, ask again."""
        while True:
            try:
                return ask()
            except httpx.TransportError:
                assert self.address.changed.wait(120)
                self.visitor.move_to(self.address.url)
                self.visitor.open_page()


@dataclass
class Story:
    """What happened in two lives of one server."""

    installation: Installation
    url: str
    person: Visitor
    step: str  # at which the person was watching drive A
    before: dict[str, Any]
    bots: list[Bot]
    acknowledged_before: set[str]


@pytest.fixture(scope="module")
def story(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Story]:
    installation = Installation(tmp_path_factory.mktemp("killed"))
    with installation.serving() as (url, process):
        address = Address(url)
        person = Visitor(url, installation.study)
        step = person.walk_to_first_trial()["key"]
        person.open_page()
        bots = [Bot(address, Visitor(url, installation.study, bot=True)) for _ in range(BOTS)]
        with person.stage() as stage:
            hear(stage, '"type": "show"')
            before = person.post(f"trials/{step}/start").json()["step"]["trial"]
            hear(stage, before["playback_id"])
            threads = [threading.Thread(target=bot.walk, daemon=True) for bot in bots]
            for thread in threads:
                thread.start()
            while sum(len(bot.acknowledged) for bot in bots) < KILLED_AFTER:
                assert any(thread.is_alive() for thread in threads)
            process.kill()
            acknowledged_before = {request_id for bot in bots for request_id in bot.acknowledged}
            process.wait()
    with installation.serving() as (url, _):
        address.move(url)
        person.move_to(url)
        for thread in threads:
            thread.join(120)
            assert not thread.is_alive(), "a bot does not get on after the restart"
        yield Story(installation, url, person, step, before, bots, acknowledged_before)


def test_every_acknowledged_answer_is_there_once(story: Story) -> None:
    assert len(story.acknowledged_before) >= KILLED_AFTER
    stored = {
        row.request_id: row.step_key for bot in story.bots for row in story.installation.responses(bot.visitor.token)
    }
    assert story.acknowledged_before <= set(stored)
    for bot in story.bots:
        assert len(bot.acknowledged) == PAIRS
        pairs = [row for row in story.installation.responses(bot.visitor.token) if row.kind == "preference"]
        assert {row.request_id: row.step_key for row in pairs} == bot.acknowledged


def test_an_answer_sent_again_after_the_restart_counts_once(story: Story) -> None:
    bot = story.bots[0]
    request_id, step = next((one, step) for one, step in bot.acknowledged.items())
    again = bot.visitor.answer(step, {"choice": "b"}, request_id)
    assert (again.status_code, again.json()["duplicate"]) == (200, True)
    stored = [row for row in story.installation.responses(bot.visitor.token) if row.request_id == request_id]
    assert [row.value for row in stored] == [{"choice": "a"}]
    assert all(state["accepted"] for bot in story.bots for state in bot.sent_again)


def test_the_person_returns_to_the_same_trial_and_the_restart_is_counted(story: Story) -> None:
    assert story.before["phase"] == "playing_a"
    page = story.person.open_page()
    assert (page.status_code, page.headers["X-Step-Key"]) == (200, story.step)
    trial = story.person.state()["step"]["trial"]
    assert (trial["phase"], trial["restarts"], trial["next_side"]) == ("ready", 1, "a")
    session = story.installation.session(story.person.token)
    interrupted = [e for e in story.installation.events("trial_interrupted") if e.session_id == session.id]
    assert [(event.data["phase"], event.data["restarts"]) for event in interrupted] == [("playing_a", 1)]
    assert story.installation.trial(story.person.token, story.step).restarts == 1
    with story.person.stage() as stage:
        hear(stage, '"type": "show"')
        playback = story.person.post(f"trials/{story.step}/start").json()["step"]["trial"]["playback_id"]
        assert playback != story.before["playback_id"], "news of the lost showing must not count for the new one"
        hear(stage, playback)
    told = story.person.post(f"trials/{story.step}/seen", drive="a", playback_id=story.before["playback_id"])
    assert told.json()["error"]["code"] in ("other_playback", "not_playing")
