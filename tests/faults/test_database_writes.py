"""`desirepath benchmark database`: every connection stores whole answers, by the very statements of the product."""

from __future__ import annotations

from pathlib import Path

import pytest
from sqlalchemy import func, select

from desirepath.store.models import Event, Response, Trial
from desirepath_experiments.benchmarks import database_writes
from desirepath_experiments.benchmarks.serving import installation
from desirepath_experiments.own_postgres import NoPostgres


def test_recorded_answers_are_stored_again_and_again_with_their_events_and_next_pairs(tmp_path: Path) -> None:
    def counted() -> dict[str, int]:
        with found.database.session() as s:
            return {one.__name__: s.scalar(select(func.count()).select_from(one)) for one in (Response, Trial, Event)}

    try:
        with installation(tmp_path, True) as found:
            recorded = database_writes.record_answer(found)
            before = counted()
            run = database_writes._run(found.database, recorded, tmp_path, connections=2, seconds=0.5)
            stored = {what: now - before[what] for what, now in counted().items()}
    except NoPostgres as problem:
        pytest.skip(str(problem))
    own = stored["Trial"] - stored["Response"]  # the first pair of every session that was prepared
    assert own % 2 == 0
    assert own > 0
    assert stored["Response"] > 0
    assert stored["Event"] == 3 * stored["Response"], "answered, step entered, query chosen"
    assert run["answers_per_s"] > 0
    assert run["log_kb_per_answer"] > 0


def test_numbers_without_room_are_refused() -> None:
    with pytest.raises(ValueError, match="connections = \\[0\\]"):
        database_writes.benchmark_database(connections=[0])
