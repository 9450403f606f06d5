"""Every benchmark's options are the fields of its configuration, looked at when the command is."""

from __future__ import annotations

import json
from dataclasses import fields
from importlib import import_module
from typing import get_type_hints

import pytest
from typer.testing import CliRunner

from desirepath.cli.main import app
from desirepath_experiments.cli.benchmark import BENCHMARKS, FLAGS


@pytest.mark.parametrize("name", BENCHMARKS)
def test_every_field_of_a_benchmarks_configuration_is_an_option(name: str) -> None:
    shown = CliRunner().invoke(app, ["benchmark", name, "--help"], env={"COLUMNS": "300"})
    assert shown.exit_code == 0, shown.output
    run = getattr(import_module(f"desirepath_experiments.{BENCHMARKS[name][0]}"), f"benchmark_{name.replace('-', '_')}")
    for field in fields(get_type_hints(run)["config"]):
        if field.name == "folder":  # what the command is about
            assert "{folder}" in shown.output
            continue
        flag = FLAGS.get(field.name, f"--{field.name.replace('_', '-')}").partition(",")[0].partition("/")[0]
        assert flag in shown.output
    assert "--json" in shown.output


def test_a_result_is_one_object_and_a_number_out_of_bounds_is_refused() -> None:
    found = CliRunner().invoke(app, ["benchmark", "words", "--part", "development", "--json"])
    assert json.loads(found.stdout)["part"] == "development"
    refused = CliRunner().invoke(app, ["benchmark", "serve", "--answers", "16"])
    assert refused.exit_code == 2
    assert "--answers" in refused.output
