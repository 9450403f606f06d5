"""The planner that knows where everybody will be: what it foresees, the way that is left, how it does."""

import math

import numpy as np

from desirepath.learning.pedestrians import crowd_networks
from desirepath.learning.pedestrians.crowd_evaluation import crowd_scene_set, evaluate_crowds
from desirepath.learning.scene_sets import Purpose
from desirepath.simulation.crowds.crowd_engine import CrowdEngine
from desirepath.simulation.crowds.crowd_scenes import PUBLISHED, draw_crowd_scene
from desirepath.simulation.setups import CONTROL_DT_S
from desirepath_experiments.training.pedestrians import foresight_kernels
from desirepath_experiments.training.pedestrians.crowd_planners import PLANNERS
from desirepath_experiments.training.pedestrians.foresight import ground_of
from desirepath_experiments.training.pedestrians.foresight_kernels import foresee


def test_commands_are_searched_and_carried_out_with_the_same_gain():
    """A compiled function uses nothing of another file, so the number stands twice."""
    assert foresight_kernels.TURN_GAIN == crowd_networks.TURN_GAIN


def test_who_is_told_where_everybody_will_be_arrives_where_the_path_alone_collides():
    scenes = crowd_scene_set(12, PUBLISHED, purpose=Purpose.SELECT, seed=0)
    rates = evaluate_crowds(None, "ranges", scenes, plan=PLANNERS["foresight"]).rates()
    assert rates["success"] >= 90
    assert rates["collision"] == 0
    assert evaluate_crowds(None, "ranges", scenes, plan=PLANNERS["follow"]).rates()["collision"] > 50


def test_the_way_that_is_left_leads_around_walls_and_who_stands():
    scene = draw_crowd_scene("crowd_corridor", 3, PUBLISHED)
    ground = ground_of(scene)
    start = scene.start.x, scene.start.y
    straight = math.dist(start, (scene.goal.x, scene.goal.y))
    i, j = round((start[0] - ground.x0) / ground.cell), round((start[1] - ground.y0) / ground.cell)
    assert straight <= ground.length[i, j] + 0.1 < 2.5 * straight
    person = scene.person.pose
    a, b = round((person.x - ground.x0) / ground.cell), round((person.y - ground.y0) / ground.cell)
    around = ground.length[max(a - 6, 0) : a + 7, max(b - 6, 0) : b + 7]
    assert ground.length[a, b] - around.min() > 3, "through who stands is dear: half a metre counts as several"
    assert ground.length.min() == 0


def test_everybody_is_foreseen_where_they_then_are():
    scene = draw_crowd_scene("crowd_office", 5, PUBLISHED)
    engine = CrowdEngine(n_envs=1)
    engine.reset([scene])
    w, people = engine.world, int(engine.world.people[0])
    places, faces = np.zeros((2, 21, people, 2))
    foresee(
        w.routes[0], w.knots[0], w.speeds[0, :people], w.people_xy[0], w.facing[0], w.heading_for[0], w.turn[0],
        CONTROL_DT_S, places, faces,
    )  # fmt: skip
    standing = np.array([[-1.0, 0.0]], np.float32)
    steps = 0
    while not engine.dones[0] and steps < 20:
        engine.step(standing)
        steps += 1
        assert np.allclose(engine.people_xy[0, :people], places[steps], atol=1e-6)
    assert steps >= 5
