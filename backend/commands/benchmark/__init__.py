"""`desirepath benchmark`: one module per thing that is measured; each puts its commands into the group."""

from __future__ import annotations

from backend.commands.benchmark import engine, serving, personalisation, methods, ceiling, cohorts  # isort: skip (the order of --help)
from backend.commands.benchmark.group import commands

__all__ = ["ceiling", "cohorts", "commands", "engine", "methods", "personalisation", "serving"]
