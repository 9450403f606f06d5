"""Scenes with crowds and their engine: what is drawn, who walks where, contact, lidar; PyBullet as the reference."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from desirepath.simulation.crowds.crowd_engine import CrowdEngine, record
from desirepath.simulation.crowds.crowd_kernels import nearest_wall
from desirepath.simulation.crowds.crowd_maps import boxes_of, map_of, path_from_anywhere
from desirepath.simulation.crowds.crowd_scenes import PUBLISHED, UNSEEN_HOMES, draw_crowd_scene, robot_path
from desirepath.simulation.crowds.crowd_setups import TRAINED_SETUPS
from desirepath.simulation.fast import make_engine
from desirepath.simulation.pedestrians import Crowd, CrowdConditions, Pedestrian, PedestrianError, where_on_route
from desirepath.simulation.scene import Person, Pose, Room, Scene, SceneError
from desirepath.simulation.scenes import draw_scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome
from desirepath_experiments.training.pedestrians.crowd_training import CrowdPool
from tests.simulation.reference_crowd import CrowdReference

CROWD_CORRIDOR = get_setup("crowd_corridor")
STUDY_ROOM = get_setup("study_room")

EIGHT = CrowdConditions(moving=(8, 8), standing=(2, 2))
STAND = np.array([[-1.0, 0.0]], np.float32)


@pytest.mark.parametrize("setup", TRAINED_SETUPS)
def test_a_scene_with_a_crowd_is_the_same_from_its_seed_and_reads_back_equal(setup):
    scene = draw_crowd_scene(setup, 5, EIGHT)
    assert scene == draw_crowd_scene(setup, 5, EIGHT) == Scene.from_dict(scene.as_dict())
    assert scene != draw_crowd_scene(setup, 6, EIGHT)
    assert len(scene.crowd.pedestrians) == 9, "eight who walk, one who stands beside the scene's person"


def test_unseen_homes_are_furnished_and_full_of_people_who_avoid():
    scene = draw_crowd_scene("crowd_home", 2, UNSEEN_HOMES)
    assert scene == Scene.from_dict(scene.as_dict())
    assert {"table", "bed", "sofa"} <= {one.kind for one in scene.obstacles}
    assert scene.crowd.behaviour == "orca"
    engine = CrowdEngine(n_envs=1)
    engine.reset([scene])
    engine.step(STAND)
    assert np.isfinite(engine.ranges).all()


def test_unseen_homes_have_one_who_walks_for_every_8_m2_that_the_robot_can_get_to():
    numbers = []
    for seed in range(5):
        scene = draw_crowd_scene("crowd_home", seed, UNSEEN_HOMES)
        inside = map_of(scene.room, boxes_of(scene), CROWD_CORRIDOR.robot.radius_m)
        seen, ahead = {inside.cell(scene.start.x, scene.start.y)}, [inside.cell(scene.start.x, scene.start.y)]
        while ahead:
            i, j = ahead.pop()
            for cell in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
                if cell not in seen and inside.free[cell]:
                    seen.add(cell)
                    ahead.append(cell)
        assert len(scene.crowd.pedestrians) == int(0.01 * len(seen) / 8)
        numbers.append(len(scene.crowd.pedestrians) - int(scene.room.length * scene.room.width / 8))
    assert max(numbers) < 0, "fewer than by the area between the walls"


def test_a_scene_without_a_crowd_keeps_its_digest():
    assert "crowd" not in draw_scene("study_room", 1).as_dict()


@pytest.mark.parametrize("setup", TRAINED_SETUPS)
def test_nobody_walks_through_walls_and_the_first_walks_near_the_robots_path(setup):
    for seed in range(6):
        scene = draw_crowd_scene(setup, seed, EIGHT)
        engine = CrowdEngine(n_envs=1)
        engine.reset([scene])
        for one in scene.crowd.pedestrians:
            for seconds in np.arange(0, 20, 0.5):
                engine.world.robots[0, :2] = where_on_route(one, seconds)[:2]
                assert nearest_wall(engine.world, 0) > 0.25
        path = np.array(robot_path(scene))
        dense = np.concatenate([np.linspace(a, b, 40) for a, b in itertools.pairwise(path)])
        first = np.array(scene.crowd.pedestrians[0].route)
        for place in (first[0], first[-1]):
            assert np.linalg.norm(dense - place, axis=1).min() < 0.6


def test_pedestrians_walk_back_and_forth_at_their_speed_and_avoid_nobody():
    scene = draw_crowd_scene("crowd_office", 3, EIGHT)
    engine = CrowdEngine(n_envs=1)
    engine.reset([scene])
    for step in range(1, 100):
        engine.world.finished[0] = False  # whatever happens to the robot
        engine.step(STAND)
        engine.world.robots[0, :2] = scene.start.x, scene.start.y
        if engine.outcomes[0] == Outcome.COLLISION:
            break
        for number, one in enumerate(scene.crowd.pedestrians, start=1):
            x, y, _ = where_on_route(one, 0.2 * step)
            assert math.dist(engine.people_xy[0, number], (x, y)) < 1e-6


@pytest.mark.parametrize("seconds", [0.0, 0.4, 3.0, 17.3, 60.0])
def test_people_go_on_from_where_they_are_so_long_after(seconds):
    bent = Pedestrian(((0.0, 0.0), (3.0, 0.0), (3.0, 2.0)), 0.7)
    stood, nowhere = Pedestrian(((1.0, 1.0),), 0.0, 0.4), Pedestrian(((1.0, 1.0), (1.0, 1.0)), 0.5)
    people = (bent, Pedestrian(((2.0, 0.0), (2.0, 3.0)), 0.5), stood, nowhere)
    times = np.arange(0.0, 40.0, 0.2)
    for before, after in zip(people, Crowd("path", people).later(seconds).pedestrians, strict=True):
        np.testing.assert_allclose(after.places_at(times), before.places_at(times + seconds), atol=1e-6)


def test_a_robot_goes_on_from_beside_a_wall_as_from_anywhere():
    scene = draw_scene("crowd_hall", 3)
    beside = replace(scene, start=replace(scene.start, x=0.0, y=scene.room.width / 2 - 0.25))
    with pytest.raises(SceneError, match="no way"):
        robot_path(beside)
    path = path_from_anywhere(beside)
    assert (path[0], path[-1]) == ((0.0, beside.start.y), (scene.goal.x, scene.goal.y))


def test_a_standing_robot_is_run_over_and_that_is_a_collision():
    at_ends = [draw_crowd_scene("crowd_corridor", seed, EIGHT) for seed in range(10)]
    scenes = at_ends + [replace(scene, start=Pose(0.0, 0.0)) for scene in at_ends]
    engine = CrowdEngine(n_envs=20)
    engine.reset(scenes)
    for _ in range(150):
        engine.step(np.repeat(STAND, 20, axis=0))
    assert (engine.outcomes[:10] == Outcome.TIMEOUT).all(), "nobody walks where the robot starts"
    assert (engine.outcomes[10:] == Outcome.COLLISION).mean() > 0.8
    assert (engine.steps[engine.outcomes == Outcome.TIMEOUT] == 150).all()


def test_who_follows_the_path_of_an_empty_building_arrives():
    scenes = [draw_crowd_scene(setup, seed, PUBLISHED) for setup in TRAINED_SETUPS for seed in range(4)]
    engine = CrowdEngine(n_envs=len(scenes))
    engine.reset(scenes)
    engine.world.people[:] = 0  # not even who stands
    for _ in range(150):
        ahead = engine.path_points[:, 2]
        bearing = np.arctan2(ahead[:, 1], ahead[:, 0])
        speed = np.where(np.abs(bearing) < 0.5, 0.6, -1.0)
        engine.step(np.stack([speed, np.clip(bearing, -1, 1)], axis=1).astype(np.float32))
    assert (engine.outcomes == Outcome.SUCCESS).all()


def test_lidar_poses_and_contacts_agree_with_pybullet():
    rng = np.random.default_rng(1)
    for setup in TRAINED_SETUPS:
        scene = draw_crowd_scene(setup, 11, EIGHT)
        engine = CrowdEngine(n_envs=1, noise_m=0.0)
        engine.reset([scene])
        with CrowdReference(CROWD_CORRIDOR) as reference:
            reference.reset(scene)
            while engine.outcomes[0] == Outcome.RUNNING:
                action = (rng.uniform(-1, 1, (1, 2)) * [1.0, 0.3]).astype(np.float32)
                engine.step(action)
                reference.step(action[0])
                assert np.abs(engine.poses[0, :2] - reference.pose[:2]).max() < 0.01
                apart = np.abs(reference.ranges.reshape(180, 8).min(axis=1) - engine.ranges[0])
                assert np.median(apart) < 0.005
                assert (apart > 0.1).mean() < 0.03, "edges apart, the same world"
            assert reference.outcome == engine.outcomes[0]


def test_the_same_seed_gives_the_same_episodes_and_evaluation_scenes_are_none_of_them():
    def run():
        engine = CrowdEngine(n_envs=4, pool=CrowdPool(TRAINED_SETUPS, 3, PUBLISHED, size=6))
        rng, kept = np.random.default_rng(0), []
        for _ in range(30):
            engine.step(rng.uniform(-1, 1, (4, 2)).astype(np.float32))
            kept.append(engine.ranges.copy())
            engine.restart()
        return np.stack(kept), [scene.seed for scene in engine.scenes]

    first, seeds = run()
    again, _ = run()
    assert np.array_equal(first, again)
    assert min(seeds) > 2**32


def test_reactive_crowds_walk_around_a_robot_that_stands_and_a_path_crowd_does_not():
    hits = {}
    for behaviour in ("path", "orca", "social_force"):
        conditions = CrowdConditions(moving=(2, 2), standing=(1, 1), behaviour=behaviour)
        scenes = [
            replace(draw_crowd_scene("crowd_intersection", seed, conditions), start=Pose(0.0, 0.0))
            for seed in range(40)
        ]
        engine = CrowdEngine(n_envs=40)
        engine.reset(scenes)
        for _ in range(150):
            engine.step(np.repeat(STAND, 40, axis=0))
        hits[behaviour] = int((engine.outcomes == Outcome.COLLISION).sum())
    assert max(hits["orca"], hits["social_force"]) < hits["path"], hits


def test_who_avoids_others_turns_back_where_they_are_held_up_for_two_seconds():
    """Two who meet in a corridor too narrow for both: without turning they stand there for ever."""
    room = Room(8.0, 1.0)
    routes = ((-2.5, 0.0), (2.5, 0.0)), ((2.5, 0.0), (-2.5, 0.0))
    crowd = Crowd("orca", tuple(Pedestrian(route, 0.5) for route in routes))
    aside = Person(Pose(3.6, 0.0))
    scene = Scene("crowd_corridor", 1, Pose(-3.6, 0.0), Pose(-3.0, 0.0), 0.2, aside, room=room, crowd=crowd)
    engine = CrowdEngine(n_envs=1)
    engine.reset([scene])
    places, waits, turned = [], [], None
    for step in range(120):
        engine.step(STAND)
        places.append(engine.people_xy[0, 1:3, 0].copy())
        waits.append(abs(engine.world.people_v[0, 1, 0]) < 0.05)
        if turned is None and engine.world.turn[0, 1] < 0:
            turned = step
    assert all(waits[turned - 9 : turned]), "who turns has waited for two seconds"
    assert not waits[turned - 16], "and not for longer than it takes to come to a halt"
    late = np.ptp(np.array(places[40:]), axis=0)
    assert (late > 1.0).all(), f"after 8 s they moved by {late} m only"


def test_where_pedestrians_were_is_kept_with_the_scene():
    scene = draw_crowd_scene("crowd_office", 1, PUBLISHED)
    engine = CrowdEngine(n_envs=1)
    engine.reset([scene])
    people, facing = [engine.people_xy[0].copy()], [engine.world.facing[0].copy()]
    for _ in range(5):
        engine.step(STAND)
        people.append(engine.people_xy[0].copy())
        facing.append(engine.world.facing[0].copy())
    kept = Scene.from_dict(record(scene, np.array(people), np.array(facing)).as_dict())
    for number, one in enumerate(kept.crowd.pedestrians, start=1):
        assert np.abs(one.walk.poses_at([0.4])[0, :2] - people[2][number]).max() < 1e-3


def test_engines_say_which_scenes_they_do_not_run():
    with pytest.raises(SceneError, match="crowd"):
        make_engine(STUDY_ROOM, 1).reset([replace(draw_scene("study_room", 1), crowd=Crowd("path", ()))])
    with pytest.raises(SceneError, match="fast engine"):
        CrowdEngine(n_envs=1).reset([draw_scene("study_room", 1)])
    with pytest.raises(PedestrianError, match="behaviour"):
        Crowd("polite", ())
