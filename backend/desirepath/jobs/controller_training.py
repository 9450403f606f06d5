"""What the job `train_demonstrations` learns: chapter 2's controller, or chapter 3's, which goes by its depth camera.

What the job keeps and compares stands in `demonstrating.py`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from desirepath.demonstrations.controllers import roll_out
from desirepath.demonstrations.demonstration import Demonstration
from desirepath.demonstrations.td3_bc import configuration
from desirepath.demonstrations.td3_bc.training import train_with_demonstrations
from desirepath.jobs.context import Part
from desirepath.jobs.kinds import JobParamsError, TrainDemonstrationsParams
from desirepath.learning.scene_sets import Purpose, describe
from desirepath.learning.shipped_files import resolve
from desirepath.perception import SHIPPED_ENCODER
from desirepath.simulation.scene import Scene
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import has_depth_camera
from desirepath.simulation.trajectory import Trajectory

EXPLORED_HOMES = 200  # ours: drawn in seconds
DEPTH_UPDATES = 40_000  # where nobody waits
EXPLORED_SEED = 2**32 + 40_000  # homes that nothing is judged in


@dataclass(frozen=True)
class Learned:
    """A controller: what is stored of it, and how it is rolled out. kind: of the artefact; results: of its training."""

    kind: str
    setup: str
    content: bytes
    config: Mapping[str, Any]
    results: Mapping[str, Any]
    scenes: Mapping[str, Any]
    departures: Sequence[str]
    roll_out: Callable[[Sequence[Scene]], list[Trajectory]]


def sensor_of(params: TrainDemonstrationsParams, setup: str) -> str:
    """`places` or `depth`. Raises JobParamsError for one that the environment was not made for."""
    fits = "depth" if has_depth_camera(setup) else "places"
    if params.sensor in (None, fits):
        return fits
    message = f"the paths were drawn in {setup}, where controllers go by {fits}: leave it open, or choose other paths"
    raise JobParamsError(
        "train_demonstrations", [{"field": "sensor", "value": params.sensor, "message": message, "code": "value_error"}]
    )


def learn(demonstrations: Sequence[Demonstration], params: TrainDemonstrationsParams, progress: Part) -> Learned:
    """Train a controller by the sensor that was asked for. Raises JobParamsError as `sensor_of` does."""
    if sensor_of(params, demonstrations[0].scene.setup) == "depth":
        return _by_depth(demonstrations, params, progress)
    return _by_places(demonstrations, params, progress)


def _by_places(demonstrations: Sequence[Demonstration], params: TrainDemonstrationsParams, progress: Part) -> Learned:
    if params.imitated:
        updates = params.updates or configuration.AFTER_IMITATION
        config = configuration.imitating_config(params.seed, updates, params.imitated)
    else:
        usual = configuration.DemonstrationConfig(seed=params.seed)
        config = replace(usual, updates=params.updates or usual.updates)
    trained = train_with_demonstrations(demonstrations, config, progress)
    policy = trained.policy.without_critic()
    return Learned(
        "policy",
        policy.setup,
        policy.to_bytes(),
        config.as_dict(),
        {"history": trained.history, "chosen": trained.chosen},
        {"select": describe(Purpose.SELECT, config.selection_scenes, params.seed)},
        [*configuration.DEPARTURES, *([configuration.IMITATION] if config.imitated else [])],
        lambda scenes: roll_out(policy, scenes),
    )


def _by_depth(demonstrations: Sequence[Demonstration], params: TrainDemonstrationsParams, progress: Part) -> Learned:
    from desirepath.demonstrations.depth.episodes import MODES, home_episodes
    from desirepath.demonstrations.depth.judging import depth_trajectories
    from desirepath.demonstrations.depth.states import CONFIGURATIONS
    from desirepath.demonstrations.depth.training import (
        DEPARTURES,
        DepthTrainingConfig,
        senses_of,
        train_depth_controller,
    )
    from desirepath.perception.beta_vae import DepthEncoder

    config = DepthTrainingConfig(seed=params.seed, updates=params.updates or DEPTH_UPDATES)
    encoder = resolve(SHIPPED_ENCODER).read_bytes()
    configured = CONFIGURATIONS["VAE-HA"]
    make = senses_of(configured, DepthEncoder.from_bytes(encoder), None, params.seed)
    homes = draw_scenes("home", range(EXPLORED_SEED, EXPLORED_SEED + EXPLORED_HOMES))
    explored = home_episodes(homes, MODES[:4], params.seed)
    controller = train_depth_controller(configured, make, explored, demonstrations, config, progress)
    seen_by = {"name": SHIPPED_ENCODER, "sha256": hashlib.sha256(encoder).hexdigest()}
    return Learned(
        "depth_controller",
        homes[0].setup,
        controller.to_bytes(),
        config.as_dict() | {"sensor": "depth", "configuration": configured.name, "encoder": seen_by},
        {},
        {"explored": {"first_scene_seed": EXPLORED_SEED, "last_scene_seed": EXPLORED_SEED + EXPLORED_HOMES - 1}},
        DEPARTURES,
        lambda scenes: depth_trajectories(controller, make, scenes),
    )
