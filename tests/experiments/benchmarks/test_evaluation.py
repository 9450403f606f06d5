"""`desirepath benchmark evaluate` times the work that people wait for. No timing is asserted."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from desirepath.cli.main import app


def test_episodes_and_a_flow_field_are_timed() -> None:
    ran = CliRunner().invoke(app, ["benchmark", "evaluate", "--episodes", "20", "--json"])
    assert ran.exit_code == 0, ran.output
    result = json.loads(ran.stdout)
    assert result["setup"] == "open_field"
    assert result["episodes"] == 20
    for work in ("evaluate", "flow_field", "flow_field_numbers"):
        told = result[work]
        assert 0 < told["networks"]["seconds"] < told["seconds"]
        assert told["wall_seconds"] > 0
        assert told["networks"]["share_of_peak"] == pytest.approx(told["networks"]["gflops"] / result["matmul_gflops"])
    assert result["flow_field"]["states"] == result["flow_field_numbers"]["states"] > result["evaluate"]["states"] > 20


def test_no_episodes_are_refused() -> None:
    assert CliRunner().invoke(app, ["benchmark", "evaluate", "--episodes", "0"]).exit_code != 0
