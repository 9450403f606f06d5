"""`desirepath benchmark`: one module per thing that is measured; each puts its commands into the group."""

from __future__ import annotations

from desirepath_experiments.cli.benchmark import engine, serving, personalisation, methods, cohorts  # isort: skip (the order of --help)
from desirepath_experiments.cli.benchmark.group import commands

__all__ = ["cohorts", "commands", "engine", "methods", "personalisation", "serving"]
