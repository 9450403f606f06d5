"""What each task of chapter 3 computes: an obstacle avoider, encoder and predictor, a controller, its rollouts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.frechet import Deviation
from desirepath.demonstrations.demonstration import Demonstration
from desirepath.demonstrations.depth.depth_controller import DepthController
from desirepath.demonstrations.depth.episodes import MODES, YAW_STD, Episodes, home_episodes
from desirepath.demonstrations.depth.judging import REMOVALS, judge_followed, roll_out_depth, without
from desirepath.demonstrations.depth.states import CONFIGURATIONS
from desirepath.demonstrations.depth.training import DepthTrainingConfig, senses_of, train_depth_controller
from desirepath.learning.policies.policy import Policy
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.learning.td3.base import BaseConfig, train_base
from desirepath.perception.beta_vae import DepthEncoder, VaeConfig
from desirepath.perception.predictor import PersonPredictor, PredictorConfig, fit_predictor
from desirepath.simulation.depth_camera import DEPTH_CAMERA, WIDE_CAMERA, CameraNoise
from desirepath.simulation.scene import Pose
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import get_setup
from desirepath_experiments.reproduction.depth.demonstrated import flat, home_demonstrations
from desirepath_experiments.reproduction.depth.encoding import EncoderTraining
from desirepath_experiments.reproduction.depth.recording import Recording, record
from desirepath_experiments.reproduction.depth.recording_measures import (
    prediction_errors,
    prediction_set,
    reconstruction,
    shown_frames,
)
from desirepath_experiments.reproduction.tasks import Function, TaskResult, as_bytes

HOME = get_setup("home")

RECORDED_SEED, EXPLORED_SEED = (
    2**32,
    2**32 + 50_000,
)  # homes of recordings and of exploration: each other's, too, unseen
HELD_OUT_HOMES, HELD_OUT_STEPS, ROBOTS = 16, 60, 64


def avoider(params: dict[str, Any], _: Sequence[TaskResult]) -> TaskResult:
    """Plain TD3 on the lidar: whoever records only has to avoid obstacles (section 3.3.2.3)."""
    updates = params["updates"]
    config = BaseConfig(
        HOME.name,
        n_envs=128,
        updates=updates,
        smoothing_updates=max(6, updates // 6),
        random_transitions=min(20_000, 4 * updates),
        selection_scenes=min(100, max(4, updates // 90)),
        checkpoints=1,
    )
    result = train_base(config)
    policy = result.policy.without_critic()
    return TaskResult({"selection_success": result.selection_success}, {"policy": as_bytes(policy.to_bytes())})


@cache
def _recording(policy: bytes, homes: int, steps: int) -> Recording:
    drawn = draw_scenes("home", range(RECORDED_SEED, RECORDED_SEED + homes))
    return record(Policy.from_bytes(policy), home_episodes(drawn, MODES[:4]), steps=steps, robots=ROBOTS)


def _record(params: dict[str, Any], avoided: TaskResult) -> Recording:
    return _recording(avoided.content("policy"), params["homes"], params["steps"])


def encoder(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """The encoder's training from the part before, if there is one, until so many batches are done."""
    training = EncoderTraining(
        _record(params, needs[0]),
        (DEPTH_CAMERA, WIDE_CAMERA),
        CameraNoise(),
        VaeConfig(batches=params["batches"]),
        needs[1].arrays if len(needs) > 1 else None,
    )
    training.run(params["until"])
    # What is stored is what is used, rounding included.
    return TaskResult(
        {"last_training_rms_m": float(np.mean(training.curve[-50:]))},
        {"encoder": as_bytes(training.encoder().to_bytes()), **training.state()},
    )


def perception(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """The predictor, and how well encoder and predictor do in homes that neither has seen."""
    policy, recording = Policy.from_bytes(needs[0].content("policy")), _record(params, needs[0])
    encoder = DepthEncoder.from_bytes(needs[1].content("encoder"))
    fitted = fit_predictor(*prediction_set(recording, encoder), PredictorConfig(batches=params["predictor_batches"]))
    predictor = PersonPredictor(fitted)
    judged_in = scene_set("home", HELD_OUT_HOMES, purpose=Purpose.REPORT, seed=1)
    held_out = record(
        policy, home_episodes(judged_in, MODES[:4]), steps=min(HELD_OUT_STEPS, params["steps"]), robots=ROBOTS, seed=1
    )
    measured = {
        "reconstruction": reconstruction(held_out, encoder),
        "prediction": prediction_errors(held_out, encoder, predictor),
        "last_training_rms_m": needs[1].meta["last_training_rms_m"],
    }
    arrays = {"encoder": as_bytes(encoder.to_bytes()), "predictor": as_bytes(predictor.to_bytes())}
    return TaskResult(measured, arrays | shown_frames(held_out, encoder))


@cache
def _demonstrate(scenes: int, per_scene: int) -> list[list[Demonstration]]:
    return home_demonstrations(scenes, per_scene)


def _senses(name: str, trained: TaskResult, seed: int) -> Any:
    encoder = DepthEncoder.from_bytes(trained.content("encoder"))
    predictor = PersonPredictor.from_bytes(trained.content("predictor"))
    return senses_of(CONFIGURATIONS[name], encoder, predictor, seed)


@cache
def _explore(homes: int, seed: int) -> Episodes:
    first = EXPLORED_SEED + 10_000 * seed
    return home_episodes(draw_scenes("home", range(first, first + homes)), MODES[:4], seed)


def controller(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """One configuration, trained."""
    name, seed = params["configuration"], params["seed"]
    policy = train_depth_controller(
        CONFIGURATIONS[name],
        _senses(name, needs[0], seed),
        _explore(params["homes"], seed),
        flat(_demonstrate(params["scenes"], params["per_scene"])),
        DepthTrainingConfig(seed=seed, updates=params["updates"]),
    )
    return TaskResult({}, {"policy": as_bytes(policy.to_bytes())})


def judged(params: dict[str, Any], needs: Sequence[TaskResult]) -> TaskResult:
    """A configuration in unseen homes by person mode, and where something was demonstrated, with things taken away."""
    make = _senses(params["configuration"], needs[0], 1_000 + params["seed"])
    policy = DepthController.from_bytes(needs[1].content("policy"))
    modes = MODES[:4]
    unseen = scene_set("home", params["unseen"], purpose=Purpose.REPORT, seed=2)
    # The same homes for every mode and every configuration.
    episodes = home_episodes([scene for scene in unseen for _ in modes], modes, seed=7)
    of_unseen = roll_out_depth(policy, make, episodes)
    shown = _demonstrate(params["scenes"], params["per_scene"])
    replayed, paths = _around(shown, params["rollouts"])
    measured: dict[str, Any] = {
        "unseen": {mode: of_unseen.rates(mode) for mode in modes} | {"all": of_unseen.rates()},
        "demonstrated": {},
    }
    for removed in REMOVALS:
        rollouts = roll_out_depth(policy, make, without(replayed, removed))
        deviations = judge_followed(rollouts, paths)
        measured["demonstrated"][removed] = rollouts.rates() | {
            **_deviation_medians(deviations),
            "per_scene": [list(_deviation_medians(deviations[i :: len(shown)]).values()) for i in range(len(shown))],
            "styles": {
                style: _deviation_medians(
                    [deviation for n, deviation in enumerate(deviations) if shown[n % len(shown)][0].style == style]
                )
                for style in sorted({shown_demonstrations[0].style for shown_demonstrations in shown})
            },
        }
    return TaskResult(measured, {})


def _deviation_medians(deviations: Sequence[Deviation]) -> dict[str, float]:
    """Medians of t* and of f there."""
    return {
        "t_star": float(np.median([deviation.t_star for deviation in deviations])),
        "f_m": float(np.median([deviation.distance_m for deviation in deviations])),
    }


def _around(
    shown: Sequence[Sequence[Demonstration]], rollouts: int
) -> tuple[Episodes, list[list[NDArray[np.floating]]]]:
    """So many starts per demonstrated scene with other headings, mode 5, and the paths demonstrated in each."""
    random = np.random.default_rng(0)
    scenes, paths = [], []
    for _ in range(rollouts):
        for demonstrations in shown:
            scene = demonstrations[int(random.integers(len(demonstrations)))].scene
            turned = (scene.start.yaw + random.normal(0.0, YAW_STD) + math.pi) % (2 * math.pi) - math.pi
            scenes.append(replace(scene, start=Pose(scene.start.x, scene.start.y, float(turned))))
            paths.append([demonstration.trajectory.poses for demonstration in demonstrations])
    return Episodes(tuple(scenes), ("replayed",) * len(scenes)), paths


FUNCTIONS: dict[str, Function] = {
    function.__name__: function for function in (avoider, encoder, perception, controller, judged)
}
