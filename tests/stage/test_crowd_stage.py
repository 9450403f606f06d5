"""Pedestrians on the stage: twenty of them walk in all three views, and where they are is where they were."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from desirepath.explain.shown_explanation import ShownAttention, ShownExplanation
from desirepath.learning.pedestrians.attended import as_trajectory, measure_attention
from desirepath.learning.pedestrians.crowd_evaluation import roll_out_crowd
from desirepath.learning.pedestrians.crowd_networks import Actor, actor_acts
from desirepath.simulation.crowds.crowd_scenes import PUBLISHED, draw_crowd_scene
from desirepath.simulation.pedestrians import CrowdConditions, where_on_route
from desirepath.simulation.scene import Scene
from desirepath.simulation.walks import Walk
from desirepath_stage.paper import crowd_tracks
from tests.stage.stage_rig import Visitor, drive
from tests.stage.test_stage import stage_of

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


SWINGS = """() => {
  const { bodies, viser } = window.desirePath;
  const gait = viser.gait("/scene1/pedestrian0");
  const swings = [];
  viser.gait = () => gait;
  bodies.use([], ["/scene1/pedestrian0"]);
  return new Promise((done) => {
    let k = 0;
    const step = () => {
      bodies.put("/scene1/pedestrian0", Math.min(k, 30) * 0.03, 0, 0);
      swings.push(gait[1]);
      if ((k += 1) < 60) setTimeout(step, 20);
      else done(swings);
    };
    step();
  });
}"""


def test_who_walks_moves_their_legs_as_long_as_they_walk_and_not_where_motion_is_not_wanted(visit: Visit) -> None:
    visitor = visit()
    stage_of(visitor).show(crowded(), "top_down")
    visitor.wait_for("ready")
    swings = visitor.frame.evaluate(SWINGS)
    assert swings[0] == 0
    assert max(swings) > 0.4
    assert swings[-1] < 0.1
    visitor.page.emulate_media(reduced_motion="reduce")
    assert max(visitor.frame.evaluate(SWINGS)) == 0


WEIGHTS = """([t, x, y, yaw]) => {
  const { attention, viser } = window.desirePath;
  attention.at(t, x, y, yaw);
  const { position, color } = viser.meshes("/scene1/attention")[0].geometry.attributes;
  const drawn = [];
  for (let quad = 0; quad < position.count / 4; quad += 1) {
    const corner = 4 * quad + 1;
    const [px, py] = [position.array[3 * corner] - x, position.array[3 * corner + 1] - y];
    drawn.push({ strength: color.array[4 * corner + 3], blue: color.array[4 * corner + 2] > color.array[4 * corner],
      reach: Math.hypot(px, py), angle: Math.atan2(py, px) - yaw });
  }
  return drawn;
}"""


def test_what_a_policy_looks_at_is_drawn_over_time_sectors_in_blue_descriptor_rays_in_red(visit: Visit) -> None:
    torch.manual_seed(3)
    actor = Actor("ours")
    for stream in (actor.read.spatial, actor.read.temporal):
        stream.score[-1].weight.data *= 10  # untrained, it would look everywhere alike
    rolled_out = roll_out_crowd(
        actor_acts(actor), "points_and_groups", draw_crowd_scene("crowd_corridor", 7, PUBLISHED)
    )
    trajectory, attention = as_trajectory(rolled_out), ShownAttention(*measure_attention(actor, rolled_out))
    nothing = ((),) * len(trajectory.poses)
    shown = ShownExplanation((), nothing, outlines=False, lidar=False, attention=attention)
    visitor = visit()
    stage = stage_of(visitor)
    stage.show(trajectory.scene, "top_down", trajectories=[trajectory], explained=shown)
    visitor.wait_for("ready", timeout_s=120)
    for row in (1, len(rolled_out.actions) - 1):
        pose = [float(value) for value in rolled_out.poses[row]]
        drawn = visitor.frame.evaluate(WEIGHTS, [row * 0.2, *pose])
        assert len(drawn) == 60
        sectors, rays = drawn[:30], drawn[30:]
        assert all(one["blue"] for one in sectors)
        assert not any(one["blue"] for one in rays)
        for quads, weights in ((sectors, attention.spatial[row]), (rays, attention.temporal[row])):
            strengths = [one["strength"] for one in quads]
            assert int(np.argmax(strengths)) == int(np.argmax(weights))
            assert np.argmax([one["reach"] for one in quads]) == np.argmax(weights)
    ahead = sectors[0]
    assert math.isclose(math.cos(ahead["angle"]), 1.0, abs_tol=1e-3), "the first sector begins straight ahead"
    stage.replay([trajectory], names=["looks"], explained=shown, view="immersive")
    visitor.frame.wait_for_function(DRAWN, timeout=120_000)


DRAWN = """() => {
  const { viser } = window.desirePath;
  const name = [2, 3].map((k) => `/scene${k}/attention`).find((one) => viser.meshes(one).length);
  const colour = name && viser.meshes(name)[0].geometry.attributes.color.array;
  return colour ? Array.from(colour).filter((_, k) => k % 4 === 3).some((alpha) => alpha > 200) : false;
}"""
