"""Another program keeps the database busy: people are asked to try again, and nothing is lost or counted twice."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from uuid import uuid4

from desirepath.store.database import BUSY_TIMEOUT_MS
from tests.faults.conftest import Served


def test_a_busy_database_puts_answers_off_and_counts_them_once(served: Served) -> None:
    bots = [served.visitor(bot=True) for _ in range(3)]
    steps = [bot.walk_to_first_trial()["key"] for bot in bots]
    for bot, step in zip(bots, steps, strict=True):
        bot.watch(step)
    ids = [uuid4().hex for _ in bots]
    release = threading.Event()
    holding = threading.Event()

    def keep_writing() -> None:
        with served.installation.database.transaction() as s:
            s.connection()
            holding.set()
            release.wait(4 * BUSY_TIMEOUT_MS / 1000)

    def answer(number: int) -> int:
        return bots[number].answer(steps[number], {"choice": "a"}, ids[number]).status_code

    with ThreadPoolExecutor(4) as threads:
        other = threads.submit(keep_writing)
        holding.wait(10)
        first = list(threads.map(answer, range(3)))
        release.set()
        other.result()
    assert first == [503] * 3
    assert [len(served.installation.responses(bot.token)) for bot in bots] == [4] * 3, "nothing was stored"
    assert [answer(number) for number in range(3)] == [200] * 3
    assert [answer(number) for number in range(3)] == [200] * 3, "a repeated request is acknowledged again"
    for bot, step, request_id in zip(bots, steps, ids, strict=True):
        stored = [row for row in served.installation.responses(bot.token) if row.step_key == step]
        assert [row.request_id for row in stored] == [request_id]


def test_a_page_that_was_put_off_reloads_by_itself(served: Served) -> None:
    bot = served.visitor(bot=True)
    with served.installation.database.transaction() as s:
        s.connection()
        answered = bot.open_page()
    assert answered.status_code == 503
    assert int(answered.headers["retry-after"]) >= 1
    assert 'http-equiv="refresh"' in answered.text
    assert "What you answered before is safe" in answered.text
    assert bot.open_page().status_code == 200
