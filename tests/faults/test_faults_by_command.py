"""The command that kills things at random moments under load, once: it strikes, waits, and counts."""

from __future__ import annotations

import pytest

from desirepath_experiments.benchmarks.faults import FaultsConfig, benchmark_faults
from desirepath_experiments.benchmarks.results import Progress
from desirepath_experiments.own_postgres import NoPostgres


def test_a_killed_server_process_costs_no_answer_and_no_job() -> None:
    try:
        found = benchmark_faults(FaultsConfig(kills=1, participants=2), Progress())
    except NoPostgres as problem:
        pytest.skip(str(problem))
    assert found["answers_acknowledged"] >= 2, "one before the fault and one after it"
    assert (found["answers_lost"], found["half_trials"], found["jobs_lost"]) == (0, 0, 0), found
    struck = found["faults"]["server"]
    assert struck["times"] == 1
    assert struck["next_answer_after_s"]["worst"] > 0
    assert struck["there_again_after_s"]["worst"] > 0


def test_bad_numbers_are_refused() -> None:
    with pytest.raises(ValueError, match="kills"):
        FaultsConfig(kills=0)
