"""Pedestrians on the stage: twenty of them walk in all three views, and where they are is where they were."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from app.paper import crowd_tracks
from backend.simulation.crowds.crowd_scenes import CrowdConditions, draw_crowd_scene
from backend.simulation.pedestrians import where_on_route
from backend.simulation.scene import Scene
from backend.simulation.walks import Walk
from tests.app.stage_rig import Visitor, drive
from tests.app.test_stage import stage_of

Visit = Callable[..., Visitor]
TWENTY = CrowdConditions(moving=(19, 19), standing=(2, 2))


def crowded() -> Scene:
    scene = draw_crowd_scene("crowd_office", 4, TWENTY)
    assert scene.crowd is not None
    assert len(scene.crowd.pedestrians) == 20
    return scene


def test_who_was_recorded_is_played_as_recorded_and_others_along_their_routes() -> None:
    scene = crowded()
    assert scene.crowd is not None
    first, *others = scene.crowd.pedestrians
    walk = Walk((0.0, 1.0), (0.0, 0.5), (0.0, 0.0), (0.0, 0.0))
    kept = replace(scene, crowd=replace(scene.crowd, pedestrians=(replace(first, walk=walk), *others)))
    tracks = crowd_tracks(kept)
    assert tracks[0][-1] == [1.0, 0.5, 0.0, 0.0]
    assert np.allclose(tracks[1][10][1:3], where_on_route(others[0], 2.0)[:2], atol=1e-3)
    assert len(tracks) == 20


def test_twenty_pedestrians_walk_in_all_three_views(visit: Visit) -> None:
    visitor = visit()
    stage = stage_of(visitor)
    scene = crowded()
    assert scene.crowd is not None
    trajectory = drive(scene, duration_s=1.0)
    for view in ("top_down", "first_person", "immersive"):
        stage.show(scene, view, trajectories=[trajectory])
        stage.play(trajectory, label="", view=view, playback_id=view)
        visitor.wait_for("played", playback_id=view)
        poses = [visitor.position_of(f"pedestrian{index}") for index in range(20)]
        for pose, one in zip(poses, scene.crowd.pedestrians, strict=True):
            x, y, _ = where_on_route(one, 1.0)
            assert math.dist(pose[:2], (x, y)) < (1.2 if one.speed else 0.01), "they go on while the end is held"
