"""The shipped encoder, predictor and VAE-HA controller of chapter 3, each with its card.

All are tasks of the reproduction (`reproduction/depth/computing.py`); a folder in which it ran gives them at once.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from backend.demonstrations.depth.training import DEPARTURES, DepthTrainingConfig
from backend.experiments.reproduction.depth.computing import (
    EXPLORED_SEED,
    FUNCTIONS,
    HELD_OUT_HOMES,
    RECORDED_SEED,
)
from backend.experiments.reproduction.depth.plan import BUDGETS, make_plan
from backend.experiments.reproduction.tasks import Task, TaskResult, Work, finish
from backend.learning.cards import Card, card_path, file_sha256, source_commit
from backend.learning.scene_sets import Purpose, describe
from backend.learning.shipped_files import DATASETS
from backend.perception.beta_vae import VaeConfig
from backend.perception.predictor import PredictorConfig
from backend.simulation.setups import HOME

ENCODER, PREDICTOR, CONTROLLER = "home/depth_encoder", "home/depth_predictor", "home/depth"
SHIPPED = "VAE-HA"
PERCEPTION_DEPARTURES = [
    "Homes are drawn by rules and people are mannequins (no iGibson); a stereo camera's noise beside 5 % dropout.",
    "The thesis does not say how reconstruction and divergence are scaled: here pixels have a standard deviation of "
    "0.05 of the range, which with beta = 3 keeps rooms and loses legs.",
    "About 50,000 pictures seen in training: the thesis's dataset is called extensive.",
]


def ship_perception(work: Path, folder: Path = DATASETS, budget: str = "small") -> list[Card]:
    """Encoder and predictor; work: the folder of finished tasks, in which what is missing is computed."""
    task = make_plan(BUDGETS[budget]).encoder
    made, params = _made(task, work), task.params
    homes = {
        "recorded": {"first_scene_seed": RECORDED_SEED, "last_scene_seed": RECORDED_SEED + params["homes"] - 1},
        "report": describe(Purpose.REPORT, HELD_OUT_HOMES, 1),
    }
    encoder = VaeConfig(batches=params["encoder_batches"]).as_dict()
    predictor = PredictorConfig(batches=params["predictor_batches"]).as_dict()
    first = _store(
        "depth_encoder",
        ENCODER,
        made.arrays["encoder"].tobytes(),
        folder,
        budget,
        config=encoder,
        scenes=homes,
        results={key: made.meta[key] for key in ("reconstruction", "last_training_rms_m")},
        departures=PERCEPTION_DEPARTURES,
        notes=["Pictures of both cameras (87 and 120 degrees) in turn; recorded by an obstacle avoider (plain TD3)."],
    )
    second = _store(
        "depth_predictor",
        PREDICTOR,
        made.arrays["predictor"].tobytes(),
        folder,
        budget,
        config=predictor,
        scenes=homes,
        results=made.meta["prediction"],
        departures=PERCEPTION_DEPARTURES,
        parents={ENCODER: first.sha256},
        notes=["It also reads how much the person's place has changed, ten times as large (ours)."],
    )
    return [first, second]


def ship_controller(work: Path, folder: Path = DATASETS, budget: str = "small") -> Card:
    """The VAE-HA controller of the first seed as the reproduction judges it; after `ship_perception`."""
    plan = make_plan(BUDGETS[budget])
    seed = plan.budget.seeds[0]
    trained, judged = plan.trained[SHIPPED, seed], plan.judged[SHIPPED, seed]
    made, found = _made(trained, work), _made(judged, work)
    first = EXPLORED_SEED + 10_000 * seed
    return _store(
        "depth_controller",
        CONTROLLER,
        made.arrays["policy"].tobytes(),
        folder,
        budget,
        config=DepthTrainingConfig(seed=seed, updates=trained.params["updates"]).as_dict(),
        scenes={
            "explored": {"first_scene_seed": first, "last_scene_seed": first + trained.params["homes"] - 1},
            "report": describe(Purpose.REPORT, judged.params["unseen"], 2),
        },
        results={key: found.meta[key] for key in ("unseen", "demonstrated")},
        parents={ENCODER: file_sha256(folder / f"{ENCODER}.npz")},
        notes=["Simulated: people and demonstrators are programmed."],
    )


def _made(task: Task, work: Path) -> TaskResult:
    kept = Work(work)
    with kept.claimed():
        finish([task], FUNCTIONS, kept, processes=1, on_task=lambda *_: None)
    return kept.load(task.key)


def _store(kind: str, name: str, content: bytes, folder: Path, budget: str, **fields: Any) -> Card:
    path = folder / f"{name}.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    card = Card(
        kind=kind,
        name=name,
        setup=HOME.name,
        file=path.name,
        sha256=file_sha256(path),
        command=f"desirepath reproduce depth --out DIR --budget {budget} && "
        "python -m backend.experiments.ship depth home --work DIR/work",
        seed=0,
        commit=source_commit(),
        **{"departures": DEPARTURES, **fields},
    )
    card.save(card_path(path))
    return card
