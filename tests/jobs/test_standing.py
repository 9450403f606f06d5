"""The process that stands ready for instant jobs."""

from __future__ import annotations

import pytest

from desirepath.jobs import process
from desirepath.jobs.process import Standing, exit_code, log_file
from desirepath.settings import Settings
from desirepath.store.database import Database

PATIENCE_S = 120


@pytest.fixture
def settings(tmp_path):
    made = Settings(data=tmp_path, _env_file=None)
    Database(made.database).migrate()
    return made


@pytest.fixture
def standing(settings):
    made = Standing(settings, allowed=True)
    made.want()
    yield made
    made.end()


def test_one_process_does_job_after_job(settings, standing):
    ready = standing.ready
    for job_id in ("erased-one", "erased-two"):  # a job without a row is nothing to do
        working = standing.take(job_id)
        assert working is ready
        assert exit_code(working, PATIENCE_S) == 0
        assert log_file(settings, job_id).exists()
        standing.give_back(working)
    assert ready.poll() is None
    standing.end()
    assert ready.poll() is not None


def test_a_second_job_at_once_gets_a_process_of_its_own(standing):
    first, second = standing.take("erased-one"), standing.take("erased-two")
    assert first.pid != second.pid
    assert [exit_code(one, PATIENCE_S) for one in (first, second)] == [0, 0]
    standing.give_back(second)
    standing.give_back(first)
    assert standing.ready.poll() is None


def test_a_process_that_died_is_found_dead_and_replaced(standing):
    killed = standing.take("erased-one")
    killed.kill()
    assert exit_code(killed, PATIENCE_S) in (0, -9), "it may have been quicker"
    killed.wait()
    standing.give_back(killed)
    assert standing.ready is not killed
    assert standing.ready.poll() is None


def test_without_one_every_job_gets_its_own(settings):
    standing = Standing(settings, allowed=False)
    standing.want()
    own = standing.take("erased-one")
    assert exit_code(own, PATIENCE_S) == 0
    standing.give_back(own)
    assert standing.ready is None


def test_one_is_started_when_wanted_and_ended_when_nobody_is_there(settings, monkeypatch):
    standing = Standing(settings, allowed=True)
    assert standing.ready is None
    standing.want()
    first = standing.ready
    standing.want()
    standing.rest()
    assert standing.ready is first
    assert first.poll() is None
    monkeypatch.setattr(process, "STANDS_S", 0.0)
    standing.rest()
    assert standing.ready is None
    assert first.poll() is not None
    standing.end()
    standing.want()
    assert standing.ready is None, "its worker ends"


def test_no_second_one_is_started_while_the_first_works(settings, standing):
    working = standing.take("erased-one")
    standing.want()
    assert standing.ready is None
    assert exit_code(working, PATIENCE_S) == 0
    standing.give_back(working)
    assert standing.ready is working
