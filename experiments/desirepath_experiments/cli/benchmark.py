"""`desirepath benchmark NAME`: each is a function of its configuration, which gives the command its options.

A module is imported when its command is called, so that `--help` stays quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, get_type_hints

import typer
from typer.core import TyperCommand

from desirepath.cli.options import RESPONSE_MODEL, OptionsOf
from desirepath_experiments.cli.options import make_command

BENCHMARKS = {
    "simulate": ("benchmarks.engines", "Steps per second of the fast engine against PyBullet, one thread each."),
    "lidar": (
        "benchmarks.map_lidar",
        "Scans per second in a map, one thread, and how far they are from those of boxes.",
    ),
    "robot": (
        "benchmarks.robot",
        "The same scenes in the fast engine and on a robot in ir-sim: success, distances, latency.",
    ),
    "train": (
        "benchmarks.base_training",
        "Seconds until a base policy reaches 94 % success, ours against Stable-Baselines3.",
    ),
    "curves": (
        "benchmarks.success_curves",
        "Time-to-success curves of a base policy: seconds of one core to 94 and 99 % success.",
    ),
    "align": (
        "benchmarks.alignment",
        "Seconds from the last answer to a policy ready to show, and what it gained on fresh scenes.",
    ),
    "serve": (
        "benchmarks.serving",
        "Many participants at once, each with a websocket: is every acknowledged answer stored?",
    ),
    "faults": (
        "benchmarks.faults",
        "Kill servers, workers, connections under load, fill the disk: what was lost? PostgreSQL of its own.",
    ),
    "robot-safety": (
        "benchmarks.robot_safety",
        "Simulated: a million scans and odometries with errors, and what the robot was told.",
    ),
    "rest": (
        "benchmarks.at_rest",
        "The demo with nobody there: processor, disk, memory; how soon it starts and begins a job.",
    ),
    "live": (
        "benchmarks.live_controls",
        "From the hand on a weight to the robot's new way in the picture, in Chromium, milliseconds.",
    ),
    "headset": (
        "benchmarks.headset_scenes",
        "Draw calls, triangles and textures of every setup's scenes in both eyes of a headset, counted.",
    ),
    "people": (
        "benchmarks.people",
        "Simulated people outside the nine objectives: how well predicted, who is shown what, gain and harm.",
    ),
    "feedback": (
        "benchmarks.feedback",
        "Simulated: what each way of answering tells in a participant's time, and what that predicts.",
    ),
    "raters": (
        "benchmarks.raters",
        "Measures of comfort fitted to all raters of a folder but one: do they order that one's scenes?",
    ),
    "headline": (
        "benchmarks.headline",
        "Simulated: what the policy of 15 answers gets of what can be attained, by preference.",
    ),
    "explanations": (
        "benchmarks.explanations",
        "Are explanations true? Deletion and insertion against random orders, per method.",
    ),
    "words": (
        "benchmarks.words",
        "How well wishes in plain English and German become preference weights, case by case.",
    ),
    "rules": (
        "benchmarks.rules",
        "Rules in plain words: read as they were meant? Obeyed in fresh homes, against no rules?",
    ),
    "null-cohorts": (
        "cohorts.interface_cohorts",
        "Simulated: how often the interface study finds something where there is nothing.",
    ),
    "known-cohorts": (
        "cohorts.interface_cohorts",
        "Simulated: how often the analysis finds what was put in, and anything else.",
    ),
    "design-cohorts": (
        "cohorts.design_cohorts",
        "Simulated: how often each test of each design finds something.",
    ),
    "further-cohorts": (
        "cohorts.further_cohorts",
        "Simulated: how often what stands beside the declared tests is said rightly and wrongly.",
    ),
    "ranking-cohorts": (
        "cohorts.ranking_cohorts",
        "Simulated: how often importance rankings show an effect of outlines and lidar.",
    ),
}
"""Command -> the module whose function `benchmark_NAME(config, progress)` it calls, and its help."""


FLAGS = {**RESPONSE_MODEL.names, "published": "--published/--null"}
"""Of fields whose option is not called as they are."""


class _Benchmark(TyperCommand):
    """Has the options of its configuration as soon as somebody looks at them."""

    loaded = False

    def get_params(self, ctx: Any) -> Any:
        if not self.loaded:
            whole = typer.main.get_command(_load(str(self.name)))
            self.params, self.callback, self.loaded = whole.params, whole.callback, True
        return super().get_params(ctx)


def _load(name: str) -> typer.Typer:
    where, words = BENCHMARKS[name]
    run = getattr(import_module(f"desirepath_experiments.{where}"), f"benchmark_{name.replace('-', '_')}")
    config = get_type_hints(run)["config"]
    options = OptionsOf(f"{config.__module__}:{config.__name__}", names=FLAGS)
    single = typer.Typer(add_completion=False)
    single.command(name, help=words)(make_command(run, options))
    return single


commands = typer.Typer(help="Benchmarks; every ratio comes from one run on this machine.", no_args_is_help=True)
for _name, (_, _help) in BENCHMARKS.items():
    commands.command(_name, help=_help, cls=_Benchmark)(lambda: None)
