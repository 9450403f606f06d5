"""Two server processes of one installation, here in one: what one of them knows, the other acts upon."""

from __future__ import annotations

import asyncio
import os
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import pytest
from limits import parse
from sqlalchemy import text, update
from typer.testing import CliRunner

from desirepath.cli.main import app
from desirepath.settings import Settings
from desirepath.store.models import ServerProcess, Study, utc_now
from desirepath.study.session.joining import join_study
from desirepath.study.studies import create_study
from desirepath.web.application import build_services
from desirepath.web.core.dependencies import Services
from desirepath.web.replicas import shared_limits, supervisor
from desirepath.web.replicas.claims import Claims
from desirepath.web.stage.listening import Listener
from desirepath.web.stage.replay_stages import Replay
from desirepath_stage.stage_server import StageServer
from tests import postgres
from tests.running import until
from tests.study.small_protocol import CROSSED, small_protocol
from tests.study.walking import twenty_queries

PATIENCE_S = 20.0
SESSION = "0123456789abcdef0123456789abcdef"


@dataclass
class Pair:
    first: Services
    second: Services


@pytest.fixture(scope="module")
def two(postgres_server: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pair]:
    folder = tmp_path_factory.mktemp("replicas")
    with postgres.holding(postgres_server, folder / "none") as url:
        settings = Settings(data=folder / "data", database_url=url, _env_file=None)
        services = [build_services(settings) for _ in range(2)]
        for number, one in enumerate(services):
            one.notices.start()
            one.peers.begin(f"127.0.0.1:{number + 1}")
        yield Pair(*services)
        for one in services:
            one.peers.end()
            one.notices.close()
            one.database.close()


def test_a_change_in_one_process_wakes_the_page_that_another_serves(two: Pair) -> None:
    async def waits() -> float:
        listener = two.first.listeners.listen(SESSION)
        began = time.monotonic()
        asyncio.get_running_loop().call_later(0.05, two.second.listeners.tell_changed, SESSION)
        await listener.wait(PATIENCE_S)
        two.first.listeners.leave(SESSION, listener)
        assert not listener.taken_over
        return time.monotonic() - began

    assert asyncio.run(waits()) < PATIENCE_S / 2


def test_of_windows_opened_at_the_same_moment_one_stays_whichever_process_has_it(two: Pair) -> None:
    async def open_everywhere(number: int) -> list[bool]:
        session = f"{number:032x}"
        opened: list[tuple[Services, Listener]] = []
        for services in (two.first, two.second, two.first, two.second, two.second, two.first):
            opened.append((services, services.listeners.listen(session)))
        deadline = time.monotonic() + PATIENCE_S
        while sum(not one.taken_over for _, one in opened) > 1 and time.monotonic() < deadline:
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.1)  # whatever else might come
        for services, one in opened:
            services.listeners.leave(session, one)
        return [one.taken_over for _, one in opened]

    for number in range(20):
        assert sum(not taken for taken in asyncio.run(open_everywhere(number))) == 1


def test_what_is_asked_of_several_processes_counts_once_for_all(two: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    limit = parse("6 per 1 minute")
    now = 1_000_000_020.0  # the beginning of a minute
    monkeypatch.setattr(shared_limits.time, "time", lambda: now)
    limiters = [two.first.limiter, two.second.limiter]
    assert [limiters[n % 2].hit(limit, "somebody") for n in range(8)] == [True] * 6 + [False] * 2
    assert not limiters[1].test(limit, "somebody")
    assert limiters[0].hit(limit, "somebody else")
    now += 90  # half of the minute before counts
    assert [limiters[n % 2].hit(limit, "somebody") for n in range(4)] == [True] * 3 + [False]
    now += 300
    assert limiters[1].test(limit, "somebody")
    assert limiters[0].hit(limit, "somebody")
    limiters[1].clear(limit, "somebody")
    assert limiters[0].get_window_stats(limit, "somebody").remaining == 6


def test_what_is_counted_leaves_answers_on_the_disk(two: Pair) -> None:
    limit = parse("1000 per 1 hour")
    for _ in range(30):
        two.first.limiter.hit(limit, "who answers")
        with two.first.database.transaction() as s:
            assert s.scalar(text("SHOW synchronous_commit")) == "on"


def test_a_claim_whose_notice_was_lost_is_announced_again(two: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    lost: list[str] = []
    claims = [
        Claims(one.notices, "tried", lambda key, holder: lost.append(f"{holder} {key}"))
        for one in (two.first, two.second)
    ]
    heard: list[bool] = []
    two.first.notices.hear("tried", lambda notice: heard.append(notice.own))
    with monkeypatch.context() as lossy:
        lossy.setattr(two.first.notices, "tell", lambda *_, **__: None)
        claims[0].claim("key", "first")
    two.first.notices.tell_missed()
    until(lambda: heard == [True])
    claims[1].claim("key", "second")
    until(lambda: lost == ["first key"])


def test_counts_of_many_at_once_are_exact(two: Pair) -> None:
    limit = parse("40 per 1 hour")
    passed: list[bool] = []

    def ask(services: Services) -> None:
        for _ in range(15):
            passed.append(services.limiter.hit(limit, "at once"))

    threads = [threading.Thread(target=ask, args=(one,)) for one in (two.first, two.second) * 2]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(passed) == 40


@dataclass
class FakeStage:
    """Hears what it is told; the real one is tried in tests/faults."""

    told: list[str] = field(default_factory=list)

    def clear(self) -> None:
        self.told.append("clear")

    def retire(self) -> None:
        self.told.append("retire")

    def show(self, *_: Any, **__: Any) -> None:
        self.told.append("show")

    def play(self, *_: Any, playback_id: str, **__: Any) -> None:
        self.told.append(f"play {playback_id}")


class FakeServer:
    def __init__(self, **stages: FakeStage) -> None:
        self.stages = stages

    def stage(self, key: str) -> FakeStage | None:
        return self.stages.get(key)

    def retire(self, key: str, stage: FakeStage) -> None:
        assert self.stages.pop(key) is stage
        stage.retire()

    def connected_keys(self) -> list[str]:
        return list(self.stages)


def serve(services: Services, **stages: FakeStage) -> FakeServer:
    server = FakeServer(**stages)
    services.presenter.server = cast("StageServer", server)
    return server


@pytest.fixture
def session(two: Pair, tmp_path: Path) -> str:
    """A session's id."""
    frozen = small_protocol(tmp_path, [CROSSED], query_set=str(twenty_queries(tmp_path)))
    with two.first.database.transaction() as s:
        study: Study = create_study(s, two.first.files, frozen, name=f"Two {tmp_path}", created_by=None)
        joined, _ = join_study(s, study, language="en", simulated=True, files=two.first.files)
        return joined.id


def test_a_stage_is_told_by_whichever_process_is_asked_and_moves_with_its_page(two: Pair, session: str) -> None:
    stage = FakeStage()
    serve(two.first, **{session: stage})
    serve(two.second)
    assert not two.second.presenter.is_connected(session)
    two.first.presenter.on_connect(cast(Any, stage), session)
    until(lambda: two.second.presenter.is_connected(session))
    before = len(stage.told)
    two.second.presenter.show(session, afresh=True)
    until(lambda: len(stage.told) > before)

    there = FakeStage()
    serve(two.second, **{session: there})
    two.second.presenter.on_connect(cast(Any, there), session)
    until(lambda: "retire" in stage.told)
    before = len(there.told)
    two.first.presenter.show(session)
    until(lambda: len(there.told) > before)
    two.second.presenter.server.stages.clear()  # type: ignore[union-attr]
    two.second.presenter.on_disconnect(cast(Any, there), session)
    until(lambda: not two.first.presenter.is_connected(session))


def test_a_replay_is_found_at_the_process_that_keeps_it(two: Pair) -> None:
    token = two.first.replays.grant(Replay((), ()))
    assert two.second.replays.key_of(token) is None
    assert two.second.replays.kept_at(token) == "127.0.0.1:1"
    granted = asyncio.run(two.second.admission.admit(token, {}, None))
    assert granted is not None
    assert granted.kept_at == "127.0.0.1:1"
    here = asyncio.run(two.first.admission.admit_peer(token, {}, None))
    assert here is not None
    assert here.kept_at is None
    assert asyncio.run(two.first.admission.admit_peer(SESSION, {}, None)) is None
    forged = f"{two.first.notices.process_id[::-1]}~{token.partition('~')[2]}"
    assert asyncio.run(two.second.admission.admit(forged, {}, None)) is None


def test_a_process_that_says_nothing_any_more_is_forgotten(two: Pair) -> None:
    gone = ServerProcess(id="gone", address="127.0.0.1:3", started_at=utc_now(), seen_at=utc_now())
    with two.first.database.transaction() as s:
        s.add(gone)
    assert [one.process_id for one in two.first.peers.living()].count("gone") == 1
    with two.first.database.transaction() as s:
        s.execute(update(ServerProcess).where(ServerProcess.id == "gone").values(seen_at=utc_now().replace(year=2020)))
    assert len(two.first.peers.living()) == 2
    assert two.second.replays.kept_at("gone~token") is None


def test_sqlite_says_why_one_process_is_all_there_can_be(tmp_path: Path) -> None:
    ended = CliRunner().invoke(app, ["serve", "--processes", "2", "--data", str(tmp_path), "--port", "1"])
    assert ended.exit_code != 0
    assert "processes = 2" in ended.output
    assert "SQLite" in ended.output
    assert "DESIREPATH_DATABASE_URL" in ended.output


def test_folders_of_counts_that_killed_supervisors_left_are_swept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    killed, held = supervisor._counts_folder()
    os.close(held)  # as the kernel does
    (killed / "histogram_1.db").write_bytes(b"x")
    living, lock = supervisor._counts_folder()
    (tmp_path / f"{supervisor.COUNTS}link").symlink_to(tmp_path.parent)
    just_made = tmp_path / f"{supervisor.COUNTS}young"
    just_made.mkdir()
    for one in (killed, living):
        os.utime(one, (0, 0))
    newest, _ = supervisor._counts_folder()
    assert {one for one in (killed, living, just_made, newest) if one.exists()} == {living, just_made, newest}
    assert tmp_path.parent.is_dir()
    os.close(lock)
