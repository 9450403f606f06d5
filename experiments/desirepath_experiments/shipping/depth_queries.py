"""Queries whose trajectories are depth controllers' among people who stand and walk, in homes that none has seen."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from desirepath.demonstrations.depth.controller import DepthController
from desirepath.demonstrations.depth.episodes import home_episodes
from desirepath.demonstrations.depth.judging import depth_trajectories
from desirepath.demonstrations.depth.training import senses_of
from desirepath.learning.queries.queries import QueryConfig, QuerySet, queries_of
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.perception.beta_vae import DepthEncoder
from desirepath.perception.predictor import PersonPredictor
from desirepath.simulation.setups import get_setup

HOME = get_setup("home")

MODES = ("static", "opposite", "random")  # of people, scene by scene
SHOWN = QueryConfig(count=12, max_duration_s=20.0, min_gap_m=0.3, scenes_per_round=16, max_scenes=160)
"""Ours: homes have narrow ways, so trajectories differ less than in open rooms."""


def generate_depth_queries(
    controllers: Sequence[DepthController],
    encoder: DepthEncoder,
    predictor: PersonPredictor | None = None,
    config: QueryConfig = SHOWN,
) -> QuerySet:
    """Pairs of these controllers' trajectories. Raises LearningError as `queries_of` does, ValueError for a controller
    that needs a predictor where none is given."""
    drawn = scene_set(HOME.name, config.max_scenes, purpose=Purpose.QUERIES, seed=config.seed)
    scenes = home_episodes(drawn, MODES, config.seed).scenes
    roll_outs = [
        partial(depth_trajectories, one, senses_of(one.configuration, encoder, predictor, config.seed))
        for one in controllers
    ]
    return queries_of(HOME.name, roll_outs, scenes, config)
