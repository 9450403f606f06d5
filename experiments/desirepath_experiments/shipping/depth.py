"""The shipped encoder, predictor and controllers of chapter 3, and queries by these: how the controllers drive past
people who stand and walk, in homes that none has seen.

All but the queries are tasks of the reproduction (`reproduction/depth/computing.py`); a folder in which it ran gives
them at once.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from desirepath.demonstrations.depth.depth_controller import DepthController
from desirepath.demonstrations.depth.episodes import home_episodes
from desirepath.demonstrations.depth.judging import depth_trajectories
from desirepath.demonstrations.depth.training import DEPARTURES, DepthTrainingConfig, senses_of
from desirepath.learning.cards import Card, file_sha256
from desirepath.learning.queries.queries import QueryConfig, queries_of
from desirepath.learning.scene_sets import Purpose, describe, scene_set
from desirepath.learning.shipping.query_sets import describe_queries
from desirepath.learning.shipping.storing import Request, store
from desirepath.perception import SHIPPED_ENCODER, SHIPPED_PREDICTOR
from desirepath.perception.beta_vae import DepthEncoder, VaeConfig
from desirepath.perception.predictor import PredictorConfig
from desirepath_experiments.reproduction.depth.chapter import BUDGETS, make_plan
from desirepath_experiments.reproduction.depth.computing import EXPLORED_SEED, FUNCTIONS, HELD_OUT_HOMES, RECORDED_SEED
from desirepath_experiments.reproduction.tasks import Task, Work, in_order, results_of

HOME = "home"
BUDGET = BUDGETS["small"]
ENCODER, PREDICTOR, QUERIES = SHIPPED_ENCODER, SHIPPED_PREDICTOR, "home/queries_depth_12"
SHIPPED = {"VAE-HA": "home/depth", "VAE-ND": "home/depth_nd"}
"""Configuration -> name: who learned from demonstrations, and who did not."""
PERCEPTION_DEPARTURES = [
    "Homes are drawn by rules and people are mannequins (no iGibson); a stereo camera's noise beside 5 % dropout.",
    "The thesis does not say how reconstruction and divergence are scaled: here pixels have a standard deviation of "
    "0.05 of the range, and count more where something is near, on the person and on thin things.",
]
MODES = ("static", "opposite", "random")  # of people, scene by scene
SHOWN = QueryConfig(count=12, max_duration_s=20.0, min_gap_m=0.3, scenes_per_round=16, max_scenes=160)
"""Ours: homes have narrow ways, so trajectories differ less than in open rooms."""


def ship_depth(request: Request) -> list[Card]:
    """All of them."""
    work = request.work or request.folder / HOME / "work"
    perception = _ship_perception(work, request.folder)
    # The controllers of the first seed, as the reproduction judges them.
    controllers = [_ship_controller(name, work, request.folder) for name in SHIPPED]
    return [*perception, *controllers, ship_queries(request.folder)]


def ship_depth_perception(request: Request) -> list[Card]:
    """Encoder and predictor."""
    return _ship_perception(request.work or request.folder / HOME / "work", request.folder)


def _ship_perception(work: Path, folder: Path) -> list[Card]:
    """Encoder and predictor; work: the folder of finished tasks, in which what is missing is computed."""
    task, batches = make_plan(BUDGET).encoder, BUDGET.encoder_batches
    (result,), params = results_of([task], FUNCTIONS, work), task.params
    homes = {
        "recorded": {"first_scene_seed": RECORDED_SEED, "last_scene_seed": RECORDED_SEED + params["homes"] - 1},
        "report": describe(Purpose.REPORT, HELD_OUT_HOMES, 1),
    }
    encoder = VaeConfig(batches=batches).as_dict()
    predictor = PredictorConfig(batches=params["predictor_batches"]).as_dict()
    first = _store(
        "depth_encoder",
        ENCODER,
        result.arrays["encoder"].tobytes(),
        folder,
        config=encoder,
        scenes=homes,
        results={key: result.meta[key] for key in ("reconstruction", "last_training_rms_m")}
        | {"core_seconds": round(_core_seconds(task, work))},
        departures=PERCEPTION_DEPARTURES,
        notes=["Pictures of both cameras (87 and 120 degrees) in turn; recorded by an obstacle avoider (plain TD3)."],
    )
    second = _store(
        "depth_predictor",
        PREDICTOR,
        result.arrays["predictor"].tobytes(),
        folder,
        config=predictor,
        scenes=homes,
        results=result.meta["prediction"],
        departures=PERCEPTION_DEPARTURES,
        parents={ENCODER: first.sha256},
        notes=["It also reads how much the person's place has changed, ten times as large (ours)."],
    )
    return [first, second]


def _ship_controller(configuration: str, work: Path, folder: Path) -> Card:
    plan = make_plan(BUDGET)
    seed = plan.budget.seeds[0]
    trained, judged = plan.trained[configuration, seed], plan.judged[configuration, seed]
    result, judged_result = results_of([trained, judged], FUNCTIONS, work)
    first = EXPLORED_SEED + 10_000 * seed
    return _store(
        "depth_controller",
        SHIPPED[configuration],
        result.arrays["policy"].tobytes(),
        folder,
        config=DepthTrainingConfig(seed=seed, updates=trained.params["updates"]).as_dict()
        | {"configuration": configuration},
        scenes={
            "explored": {"first_scene_seed": first, "last_scene_seed": first + trained.params["homes"] - 1},
            "report": describe(Purpose.REPORT, judged.params["unseen"], 2),
        },
        results={key: judged_result.meta[key] for key in ("unseen", "demonstrated")},
        parents={ENCODER: file_sha256(folder / f"{ENCODER}.npz")},
        notes=["Simulated: people and demonstrators are programmed."],
    )


def ship_queries(folder: Path, config: QueryConfig = SHOWN) -> Card:
    """Queries by the controllers in the same folder. Raises LearningError for too few."""
    files = {configuration: folder / f"{name}.npz" for configuration, name in SHIPPED.items()}
    controllers = [DepthController.from_bytes(file.read_bytes()) for file in files.values()]
    encoder = DepthEncoder.from_bytes((folder / f"{ENCODER}.npz").read_bytes())
    drawn = scene_set(HOME, config.max_scenes, purpose=Purpose.QUERIES, seed=config.seed)
    roll_outs = [
        partial(depth_trajectories, controller, senses_of(controller.configuration, encoder, None, config.seed))
        for controller in controllers
    ]
    scenes, size = home_episodes(drawn, MODES, config.seed).scenes, config.scenes_per_round
    rounds = (scenes[first : first + size] for first in range(0, len(scenes), size))
    queries = queries_of(HOME, roll_outs, rounds, config)
    return _store(
        "query_set",
        QUERIES,
        queries.to_bytes(),
        folder,
        config=config.as_dict()
        | {"controllers": {controller: file_sha256(file) for controller, file in files.items()}},
        scenes={"drawn": describe(Purpose.QUERIES, queries.filtered["scenes"], config.seed)},
        results=describe_queries(queries),
        parents={ENCODER: file_sha256(folder / f"{ENCODER}.npz")},
        notes=[
            "The controllers are made again by the same command; they need not lie beside.",
            "The person stands, walks towards the robot, or walks elsewhere, scene by scene; simulated.",
        ],
    )


def _core_seconds(task: Task, work: Path) -> float:
    """Of one core: this task and all that it needs."""
    results = Work(work)
    return sum(float(results.load(needed).meta["made"]["cpu_seconds"]) for needed in in_order([task]))


def _store(kind: str, name: str, content: bytes, folder: Path, **fields: Any) -> Card:
    command = "desirepath reproduce depth --out DIR --budget small && desirepath ship depth home --work DIR/work"
    return store(kind, name, content, folder, **{"command": command, "departures": DEPARTURES} | fields)
