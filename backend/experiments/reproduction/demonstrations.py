"""Chapter 2 as pieces of work: which there are for a budget, and what each computes.

Figures and report are made in `demonstrations_figures.py` and `demonstrations_report.py`. Everything is simulated:
those who demonstrate are the programmed demonstrators.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backend.analysis.metrics import collision_rate, measure, success_rate, timeout_rate
from backend.demonstrations.controllers import BASELINES, drive
from backend.demonstrations.demonstration import Demonstration
from backend.demonstrations.demonstrators import STYLES, demonstrate
from backend.demonstrations.judging import KINDS, judge_drives, speed_profile, unseen_scenes
from backend.demonstrations.td3_bc.configuration import DemonstrationConfig
from backend.demonstrations.td3_bc.training import train_with_demonstrations
from backend.experiments.reproduction.tasks import Function, Made, Piece
from backend.learning.policies.policy import Policy
from backend.learning.scene_sets import Purpose
from backend.simulation.demonstration_scenes import demonstration_scenes
from backend.simulation.trajectory import Trajectory

OURS = "ours"
WITHOUT = "no_demonstrations"
CONTROLLERS = (OURS, *BASELINES)
VARIANTS: dict[str, dict[str, Any]] = {  # what training is without one of its parts
    OURS: {},
    "no_cloning": {"bc_weight": [0.0, 0.0]},
    "no_boost": {"goal_boost": DemonstrationConfig().explored_goal},
    "neither": {"bc_weight": [0.0, 0.0], "goal_boost": DemonstrationConfig().explored_goal},
    # As base policies are trained: the goal's whole reward where it is reached, progress, and a long random beginning.
    WITHOUT: {
        "demonstrations": False,
        "near": 0.0,
        "mixed": 0.0,
        "explored_goal": 5.0,
        "progress_weight": 1.0,
        "random_transitions": 50_000,
    },
}
PER_PAIR = 4  # demonstrations; the thesis's participants gave three to five
SECONDS_PER_UPDATE = 0.0025
SECONDS_PER_BASELINE_SCENE = 0.05
JUDGED_S = 1.0


@dataclass(frozen=True)
class Budget:
    """How much is computed. ablated: the style for which every variant is trained, in the first environment.
    controls: ablation and training without demonstrations; else ours alone is trained.
    """

    name: str
    environments: tuple[str, ...]
    seeds: tuple[int, ...]
    updates: int
    ablated: str
    unseen: int
    styles: tuple[str, ...] = tuple(STYLES)
    per_pair: int = PER_PAIR
    controls: bool = True


BUDGETS = {
    budget.name: budget
    for budget in (
        Budget("small", ("room",), (0,), 8_000, "field_of_view", 100),
        # As many updates as a study gives while the participant waits.
        Budget("full", ("room", "corridor"), (0, 1, 2), 16_000, "field_of_view", 100),
        # As many as training has by default.
        Budget(
            "long", ("room", "corridor"), (0, 1, 2), DemonstrationConfig().updates, "field_of_view", 100, controls=False
        ),
    )
}


@dataclass(frozen=True)
class Cell:
    """One controller of one demonstrator's: environment, style, variant or baseline, seed."""

    environment: str
    style: str
    controller: str
    seed: int


@dataclass(frozen=True)
class Plan:
    """trained: the training of a cell; judged: its drives from demonstrated starts; unseen: those elsewhere, for a
    baseline the same piece in every style's cell, because it knows of none.
    """

    budget: Budget
    trained: dict[Cell, Piece]
    judged: dict[Cell, Piece]
    unseen: dict[Cell, Piece]

    def pieces(self) -> list[Piece]:
        """All of them; needs come along."""
        return [*self.judged.values(), *self.unseen.values()]


def make_plan(budget: Budget) -> Plan:
    """Which pieces a budget has."""
    trained: dict[Cell, Piece] = {}
    judged: dict[Cell, Piece] = {}
    unseen: dict[Cell, Piece] = {}
    for environment in budget.environments:
        for style in budget.styles:
            variants: Sequence[str] = (OURS, WITHOUT)
            if not budget.controls:
                variants = (OURS,)
            elif environment == budget.environments[0] and style == budget.ablated:
                variants = tuple(VARIANTS)
            for seed in budget.seeds:
                shown = {"environment": environment, "style": style, "per_pair": budget.per_pair, "seed": seed}
                elsewhere = {"environment": environment, "seed": seed, "scenes": budget.unseen}
                for variant in variants:
                    cell = Cell(environment, style, variant, seed)
                    config = {"seed": seed, "updates": budget.updates, **VARIANTS[variant]}
                    # Who learns without demonstrations is one controller for all styles; the style only tells beside
                    # which demonstrations its curve is measured.
                    beside = budget.ablated if variant == WITHOUT else style
                    training = Piece(
                        "controller",
                        {**shown, "style": beside, "config": config},
                        seconds=budget.updates * SECONDS_PER_UPDATE,
                    )
                    trained[cell] = training
                    judged[cell] = Piece("judged", {**shown, "controller": OURS}, (training,), JUDGED_S)
                    unseen[cell] = Piece("unseen", {**elsewhere, "controller": OURS}, (training,), JUDGED_S)
                for baseline in BASELINES:
                    cell = Cell(environment, style, baseline, seed)
                    judged[cell] = Piece("judged", {**shown, "controller": baseline}, seconds=JUDGED_S)
                    seconds = SECONDS_PER_BASELINE_SCENE * len(KINDS) * budget.unseen
                    unseen[cell] = Piece("unseen", {**elsewhere, "controller": baseline}, seconds=seconds)
    return Plan(budget, trained, judged, unseen)


def demonstrations_of(params: Mapping[str, Any]) -> list[Demonstration]:
    """What the programmed demonstrator draws: `per_pair` strokes of each pair, others for another seed."""
    first = params["seed"] * params["per_pair"]
    return [
        demonstrate(params["style"], scene, first + k)
        for scene in demonstration_scenes(params["environment"])
        for k in range(params["per_pair"])
    ]


def config_of(params: Mapping[str, Any]) -> DemonstrationConfig:
    """The configuration a piece's JSON names; lists become tuples."""
    changes: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in params["config"].items()}
    return replace(DemonstrationConfig(), **changes)


def controller(params: dict[str, Any], needs: Sequence[Made]) -> Made:
    """Train; the curve holds the CPU seconds until each checkpoint, its own measuring included."""
    began = time.process_time()
    seconds: list[float] = []

    def note(_: float, metrics: dict[str, float]) -> None:
        if "score" in metrics:
            seconds.append(time.process_time() - began)

    trained = train_with_demonstrations(demonstrations_of(params), config_of(params), note)
    curve = [{**point, "cpu_s": spent} for point, spent in zip(trained.history, seconds, strict=True)]
    content = trained.policy.without_critic().to_bytes()
    return Made({"curve": curve, "chosen": trained.chosen}, {"policy": np.frombuffer(content, dtype=np.uint8)})


def _driver(params: Mapping[str, Any], needs: Sequence[Made]) -> str | Policy:
    return Policy.from_bytes(needs[0].arrays["policy"].tobytes()) if needs else str(params["controller"])


def judged(params: dict[str, Any], needs: Sequence[Made]) -> Made:
    """Drives from every demonstrated start, measured; the demonstrations measured beside them."""
    demonstrations = demonstrations_of(params)
    drives = drive(_driver(params, needs), [d.scene for d in demonstrations])
    arrays = {**_shown(drives, "driven"), **_shown([d.trajectory for d in demonstrations], "demonstrated")}
    return Made({"judged": judge_drives(drives, demonstrations).as_dict()}, arrays)


def unseen(params: dict[str, Any], needs: Sequence[Made]) -> Made:
    """Drives where nothing was demonstrated, in the reporting scenes of the seed, measured."""
    pairs = demonstration_scenes(params["environment"])
    found: dict[str, Any] = {}
    for kind in KINDS:
        scenes = unseen_scenes(pairs, kind, params["scenes"], purpose=Purpose.REPORT, seed=params["seed"])
        measured = measure(drive(_driver(params, needs), scenes))
        found[kind] = {
            "n": len(scenes),
            "success_rate": success_rate(measured.outcome),
            "collision_rate": collision_rate(measured.outcome),
            "timeout_rate": timeout_rate(measured.outcome),
            "min_human_distance_m": float(measured.min_human_distance.mean()),
        }
    return Made({"unseen": found}, {})


def _shown(drives: Sequence[Trajectory], name: str) -> dict[str, NDArray[Any]]:
    """What figures need of drives: poses padded with NaN, numbers of chapter 2, speed profiles."""
    measured = measure(drives)
    poses = np.full((len(drives), max(len(t.poses) for t in drives), 3), np.nan, dtype=np.float32)
    for row, trajectory in zip(poses, drives, strict=True):
        row[: len(trajectory.poses)] = trajectory.poses
    return {
        f"{name}_poses": poses,
        f"{name}_outcome": measured.outcome,
        f"{name}_relative_path_length": measured.relative_path_length,
        f"{name}_min_human_distance": measured.min_human_distance,
        f"{name}_path_area": measured.path_area,
        f"{name}_speeds": np.stack([speed_profile(t) for t in drives]),
    }


FUNCTIONS: dict[str, Function] = {"controller": controller, "judged": judged, "unseen": unseen}
