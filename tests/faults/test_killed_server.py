"""kill -9 of the server while people drive, answer and wait: nothing that was acknowledged is lost."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

from tests.faults.installation import Bot, Installation, Visitor, hear

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

    def find(self, visitor: Visitor) -> None:
        """Wait for the server's next life and load the page as a browser would."""
        assert self.changed.wait(120)
        visitor.move_to(self.url)
        visitor.open_page()


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
        bots = [Bot(Visitor(url, installation.study, bot=True), PAIRS, address.find) for _ in range(BOTS)]
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
    told = story.person.post(f"trials/{story.step}/seen", side="a", playback_id=story.before["playback_id"])
    assert told.json()["error"]["code"] in ("other_playback", "not_playing")
