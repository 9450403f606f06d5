"""kill -9 of one server process after the other, while bots answer and a person watches: all go on in another one."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families
from websockets.exceptions import ConnectionClosed

from tests import postgres
from tests.faults.installation import Bot, Installation, Visitor, hear
from tests.faults.test_killed_benchmark import alive, children
from tests.running import until

BOTS, PAIRS = 3, 4
PATIENCE_S = 90.0


def wait_a_little(_: Visitor) -> None:
    time.sleep(0.1)


def test_whoever_was_served_by_a_killed_process_goes_on_in_another(postgres_server: str, tmp_path: Path) -> None:
    with postgres.holding(postgres_server, tmp_path / "none") as url:
        installation = Installation(tmp_path / "data", url)
        with installation.serving(processes=2) as (address, supervisor):
            servers = both(supervisor.pid)
            person = Visitor(address, installation.study)
            step = person.walk_to_first_trial()["key"]
            person.open_page()
            bots = [Bot(Visitor(address, installation.study, bot=True), PAIRS, wait_a_little) for _ in range(BOTS)]
            threads = [threading.Thread(target=bot.walk, daemon=True) for bot in bots]
            with person.stage() as stage:
                hear(stage, '"type": "show"')
                before = person.post(f"trials/{step}/start").json()["step"]["trial"]
                hear(stage, before["playback_id"])
                for thread in threads:
                    thread.start()
                for server in servers:  # one of them has the person's stage
                    until(lambda: sum(len(bot.acknowledged) for bot in bots) >= 1)
                    os.kill(server, signal.SIGKILL)
                    until(lambda killed=server: killed not in (living := both(supervisor.pid)) and len(living) == 2)
                with pytest.raises(ConnectionClosed):
                    hear(stage, "what nobody says any more")
            for thread in threads:
                thread.join(PATIENCE_S)
                assert not thread.is_alive(), "a bot does not get on"
            with fresh(person).stage() as stage:
                hear(stage, '"type": "show"')
                trial = person.state()["step"]["trial"]
                assert (trial["phase"], trial["next_side"]) == ("ready", "a")
                assert trial["restarts"] >= 1
                playback = person.post(f"trials/{step}/start").json()["step"]["trial"]["playback_id"]
                hear(stage, playback)
            for bot in bots:
                rows = installation.responses(bot.visitor.token)
                assert {row.request_id: row.step_key for row in rows if row.kind == "preference"} == bot.acknowledged
            counted = answers_counted(address)
            assert counted >= BOTS * PAIRS, "what killed processes had counted is in the sum that any process tells"
            assert answers_counted(address) == counted
        until(lambda: not any(alive(one) for one in (supervisor.pid, *both(supervisor.pid))))
        installation.database.close()


def answers_counted(address: str) -> float:
    """How many answers were taken, as whichever process takes the connection tells Prometheus."""
    return sum(
        sample.value
        for family in text_string_to_metric_families(httpx.get(f"{address}/metrics").text)
        for sample in family.samples
        if sample.name == "desirepath_request_seconds_count"
        and sample.labels["route"].endswith("/steps/{key}")
        and sample.labels["status"] == "200"
    )


def both(supervisor: int) -> list[int]:
    """The server processes that listen already."""
    deadline = time.monotonic() + PATIENCE_S
    while len(found := [one for one in children(supervisor) if alive(one)]) < 2 and alive(supervisor):
        if time.monotonic() > deadline:
            break
        time.sleep(0.05)
    return found


def fresh(person: Visitor) -> Visitor:
    """The same browser with new connections: those to a killed process are gone."""
    while True:
        try:
            person.open_page()
            return person
        except httpx.TransportError:
            time.sleep(0.1)
