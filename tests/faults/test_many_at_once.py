"""Many participants at once: the benchmark of the server, small, and that it notices a lost answer."""

from __future__ import annotations

import pytest

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath_experiments.benchmarks import serving as benchmark
from desirepath_experiments.own_postgres import NoPostgres
from tests.answered_study import add_answered_study


def test_every_participant_answers_through_http_and_a_websocket() -> None:
    measured = benchmark.benchmark_serve(benchmark.ServeConfig(sessions=3, answers=2))
    assert measured["answers_sent"] == measured["answers_acknowledged"] == measured["answers_stored"] == 6
    assert measured["errors"] == []
    assert measured["stage_messages"] >= 3 * 2 * 2, "every stage was told of every drive"
    assert 0 < measured["p50_ack_ms"] <= measured["p95_ack_ms"]
    assert measured["rss_mb"] > 0


def test_on_postgresql_a_session_s_rows_commits_and_bytes_are_told_too() -> None:
    try:
        measured = benchmark.benchmark_serve(benchmark.ServeConfig(sessions=2, answers=1, postgresql=True))
    except NoPostgres as problem:
        pytest.skip(str(problem))
    assert measured["answers_stored"] == 2
    # consent, questions, practice and one pair: each answer is a row of its own, and a transaction of its own
    assert measured["rows_per_session"] > 8
    assert measured["commits_per_session"] > measured["answers_stored"] / 2
    assert measured["log_kb_per_session"] > 0
    assert measured["database_s_per_session"] > 0
    assert measured["server_s_per_session"] > 0


def test_few_participants_are_as_much_work_as_fifty_people_and_many_answer_like_people() -> None:
    load = {n: n / benchmark.usual_pace_s(n) for n in (1, 20, 50)}
    assert load[1] == load[20] == load[50] == 2.5
    assert benchmark.usual_pace_s(100) == benchmark.PACE_S


def test_a_lost_and_a_foreign_answer_are_noticed(database: Database, files: ArtefactStore) -> None:
    add_answered_study(database, files, answers=2)
    with database.session() as s:
        rows = s.query(benchmark.Response).all()
        place = {row.step_key: (s.get_one(benchmark.Session, row.session_id).token_hash, row.step_key) for row in rows}
    seen = {row.request_id: place[row.step_key] for row in rows}
    complete = benchmark.Tally(acknowledged=dict(seen), pairs=set(seen))
    assert benchmark.count_stored(database, complete) == 2
    lost = benchmark.Tally(acknowledged={**seen, "never-stored": place[rows[0].step_key]}, pairs=set(seen))
    with pytest.raises(benchmark.ServeBenchmarkError, match="of 3 acknowledged answers 1 are not stored"):
        benchmark.count_stored(database, lost)
    del seen[rows[0].request_id]
    with pytest.raises(benchmark.ServeBenchmarkError, match="1 were stored without being acknowledged"):
        benchmark.count_stored(database, benchmark.Tally(acknowledged=seen, pairs=set(seen)))


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"sessions": 0}, "sessions\n.* greater than or equal to 1 "),
        ({"answers": 16}, "answers\n.* less than or equal to 15 "),
        ({"pace": 0.0}, "pace\n.* greater than or equal to 0.1 "),
    ],
)
def test_numbers_without_room_are_refused(given: dict[str, float], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        benchmark.ServeConfig(**given)
