"""The training process that waits for a participant's job."""

from __future__ import annotations

import os
import signal

import pytest

from backend.jobs.process import Spare, log_file
from backend.settings import Settings
from backend.store.database import Database


@pytest.fixture
def settings(tmp_path):
    made = Settings(data=tmp_path, _env_file=None)
    Database(made.database).migrate()
    return made


def test_waiting_process_takes_the_job_and_the_next_one_waits(settings):
    spare = Spare(settings, wanted=True)
    try:
        waiting = spare._waiting
        taken = spare.take("erased-meanwhile")
        assert taken is waiting
        assert taken.wait(120) == 0, "a job without a row is nothing to do"
        assert log_file(settings, "erased-meanwhile").exists()
        following = spare._waiting
        assert following.pid != taken.pid
        assert following.poll() is None
    finally:
        spare.end()
    assert following.poll() is not None


def test_spare_that_died_is_replaced(settings):
    spare = Spare(settings, wanted=True)
    try:
        spare._waiting.kill()
        spare._waiting.wait()
        taken = spare.take("erased-meanwhile")
        assert taken.wait(120) == 0
    finally:
        spare.end()


def test_without_a_spare_a_process_is_started(settings):
    spare = Spare(settings, wanted=False)
    assert spare._waiting is None
    taken = spare.take("erased-meanwhile")
    os.kill(taken.pid, signal.SIGKILL)
    taken.wait()
