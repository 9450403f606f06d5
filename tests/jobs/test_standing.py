"""The process that stands ready for instant jobs."""

from __future__ import annotations

import pytest

from desirepath.jobs.process import Standing, ended, log_file
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
    made = Standing(settings, wanted=True)
    yield made
    made.end()


def test_one_process_does_job_after_job(settings, standing):
    ready = standing.ready
    for job_id in ("erased-one", "erased-two"):  # a job without a row is nothing to do
        process = standing.take(job_id)
        assert process is ready
        assert ended(process, PATIENCE_S) == 0
        assert log_file(settings, job_id).exists()
        standing.give_back(process)
    assert ready.poll() is None
    standing.end()
    assert ready.poll() is not None


def test_a_second_job_at_once_gets_a_process_of_its_own(standing):
    first, second = standing.take("erased-one"), standing.take("erased-two")
    assert first.pid != second.pid
    assert [ended(process, PATIENCE_S) for process in (first, second)] == [0, 0]
    standing.give_back(second)
    standing.give_back(first)
    assert standing.ready.poll() is None


def test_a_process_that_died_is_found_dead_and_replaced(standing):
    process = standing.take("erased-one")
    process.kill()
    assert ended(process, PATIENCE_S) in (0, -9), "it may have been quicker"
    process.wait()
    standing.give_back(process)
    assert standing.ready is not process
    assert standing.ready.poll() is None


def test_without_one_every_job_gets_its_own(settings):
    standing = Standing(settings, wanted=False)
    process = standing.take("erased-one")
    assert ended(process, PATIENCE_S) == 0
    standing.give_back(process)
    assert standing.ready is None
