"""The controller drives as the engine does, from what a robot says, and is told what the policy prefers meanwhile."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from desirepath.deploy.conditioning import WeightsError
from desirepath.deploy.controller import Controller
from desirepath.deploy.inputs import Command, InputError, Odometry, Person, Scan
from desirepath.deploy.manifest import read_manifest
from desirepath.deploy.observing import Observer
from desirepath.deploy.predicting import predict_way
from desirepath.learning.policies.adaptable import AdaptablePolicy
from desirepath.learning.policies.bundles import bundle_files, scan_in, zipped
from desirepath.learning.policies.export import policy_to_onnx
from desirepath.learning.policies.foreign import ForeignPolicy
from desirepath.learning.policies.manifest import robot_manifest, setup_manifest
from desirepath.learning.policies.policy import Policy, StoredPolicy
from desirepath.learning.policies.shipped import load_conditioned, load_policy
from desirepath.learning.shipped_files import resolve
from desirepath.simulation.fast import FastEngine, rollout
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import Setup, get_setup
from tests.deploy.side_by_side import compare, heard

ROOM = get_setup("study_room")
CLOSE = 1e-5


def controllers(policy: StoredPolicy, count: int, weights: str = "") -> list[Controller]:
    content = zipped(bundle_files(policy, weights))
    return [Controller.load(content) for _ in range(count)]


def test_it_commands_what_the_engine_does_recoveries_included() -> None:
    """As 200 scenes do, of which some have recoveries; here the policy is made to get stuck half-way."""
    whole = load_conditioned("study_room/conditioned").weighed({"slower_near_person": 1.0, "farther": 0.5})
    scenes = draw_scenes(ROOM, range(40_000, 40_006))
    usual = compare(ROOM, whole, controllers(whole, 6), scenes)
    assert usual.steps > 60
    assert (usual.observation, usual.command) == (0.0, pytest.approx(0.0, abs=CLOSE))
    standing = replace(whole, actor=tuple(np.zeros_like(layer) for layer in whole.actor))
    stuck = compare(ROOM, standing, controllers(standing, 3), scenes[:3])
    assert stuck.by["recovery 1"] > 10
    assert stuck.by["policy"] > 90
    assert stuck.command < CLOSE


def test_where_it_would_go_is_where_it_goes() -> None:
    """A second ahead, of what is seen at the start alone; what it was asked leaves the controller as it was."""
    whole = load_policy("study_room/base")
    scenes = draw_scenes(ROOM, range(40_000, 40_008))
    (controller,), apart = controllers(whole, 1), []
    for driven in rollout(ROOM, whole.rollout_policy, scenes):
        scene, start = driven.scene, driven.scene.start
        odometry, person = Odometry(0.0, start.x, start.y, start.yaw, 0.0, 0.0), scene.person.pose
        heard_now = (scan_in(ROOM, scene, start), odometry, (scene.goal.x, scene.goal.y), [Person(person.x, person.y)])
        controller.reset()
        way = predict_way(controller, *heard_now)
        command = controller.step(*heard_now)
        controller.reset()
        assert command == controller.step(*heard_now)
        assert 5 <= len(way) <= 20
        apart.append(math.dist(way[4], driven.poses[5, :2]))
    assert np.median(apart) < 0.05
    assert max(apart) < 0.5


def test_whoever_is_freed_by_nothing_stands_in_both() -> None:
    still = load_policy("study_room/base").without_critic()
    still = replace(still, actor=tuple(np.zeros_like(layer) for layer in still.actor))
    turning = tuple(np.ones_like(layer) if k == len(still.actor) - 1 else layer for k, layer in enumerate(still.actor))
    circling = replace(still, actor=turning, recovery_policies=(turning,))
    scenes = [scene for scene in draw_scenes(ROOM, range(30)) if scene.human_distance_ceiling_m() > 2.5][:2]
    found = compare(ROOM, circling, controllers(circling, len(scenes)), scenes)
    assert found.by["standing"] > found.by["recovery 1"] > 0
    assert found.command < CLOSE


def test_weights_are_set_while_it_drives() -> None:
    conditioned = load_conditioned("study_room/conditioned")
    controller = controllers(conditioned, 1)[0]
    engine = FastEngine(ROOM, 1, auto_reset=False, scenes=draw_scenes(ROOM, [11]))
    given = heard(engine, 0, 0.0)
    assert controller.objectives == conditioned.objectives
    for weights in ({}, {"farther": 1.0}, {"slower_near_person": 1.0, "clearance": 0.5}):
        controller.weights = weights
        assert {name: value for name, value in controller.weights.items() if value} == weights
        controller.step(*given)
        expected = conditioned.weighed(weights).act(engine.observations)[0]
        np.testing.assert_allclose(controller.action, expected, atol=1e-6)
    for wrong, said in (
        ({"politeness": 1.0}, "'politeness'"),
        ({"farther": 1.5}, "farther = 1.5"),
        ({"farther": math.nan}, "farther = nan"),
        ({"farther": 0.5, "closer": 0.5}, "opposites"),
    ):
        with pytest.raises(WeightsError, match=said):
            controller.weights = wrong
    assert controller.weights["clearance"] == 0.5, "what was refused changes nothing"
    fixed = controllers(conditioned, 1, "farther=1")[0]
    assert fixed.objectives == ()
    with pytest.raises(WeightsError, match="takes no weights"):
        fixed.weights = {"farther": 0.5}


def test_a_triangles_weights_sum_to_one() -> None:
    policy = AdaptablePolicy.load(resolve("adaptable/policy"))
    controller = controllers(policy, 1)[0]
    setup = get_setup("adaptable")
    engine = FastEngine(setup, 1, auto_reset=False, scenes=draw_scenes(setup, [3]))
    for weights in ({}, {"distance": 1.0}, {"demonstration": 0.5, "efficiency": 0.5}):
        controller.weights = weights
        controller.step(*heard(engine, 0, 0.0))
        np.testing.assert_allclose(controller.action, policy.weighed(weights).act(engine.observations)[0], atol=1e-6)
    with pytest.raises(WeightsError, match=r"sum to 0\.5"):
        controller.weights = {"distance": 0.5}


def test_a_policy_of_others_drives_by_onnxruntime() -> None:
    base = load_policy("study_room/base")
    foreign = ForeignPolicy("study_room", policy_to_onnx(base), load_conditioned("study_room/conditioned").slowing)
    controller = controllers(foreign, 1)[0]
    engine = FastEngine(ROOM, 1, auto_reset=False, scenes=draw_scenes(ROOM, [11]))
    controller.step(*heard(engine, 0, 0.0))
    expected = replace(base, slowing=foreign.slowing).act(engine.observations)[0]
    np.testing.assert_allclose(controller.action, expected, atol=1e-5)


@pytest.mark.parametrize("part", [2 * math.pi, 1.5 * math.pi], ids=["all round", "270 degrees"])
def test_other_lidars_are_heard_as_the_engine_sees_them(part: float) -> None:
    lidar = replace(ROOM.robot.lidar, beams=540, sectors=54, field_of_view_rad=part, x_m=0.2, y_m=-0.05, yaw_rad=0.3)
    setup = replace(ROOM, robot=replace(ROOM.robot, lidar=lidar))
    observe = observer(setup)
    engine = FastEngine(setup, 12, auto_reset=False, scenes=draw_scenes(ROOM, range(12)))
    for i in range(12):
        scan, *others = heard(engine, i, 0.0)
        np.testing.assert_array_equal(observe(scan, *others), engine.observations[i])
        back = replace(
            scan,
            ranges=scan.ranges[::-1].copy(),
            angle_min=scan.angle_min + (len(scan.ranges) - 1) * scan.angle_increment,
            angle_increment=-scan.angle_increment,
        )
        np.testing.assert_array_equal(observe(back, *others), engine.observations[i], "a laser upside down")
        rounded = replace(
            scan, **{one: float(np.float32(getattr(scan, one))) for one in ("angle_min", "angle_increment")}
        )
        np.testing.assert_array_equal(observe(rounded, *others), engine.observations[i], "angles as ROS rounds them")


def observer(setup: Setup, laser: tuple[float, float, float] | None = None) -> Observer:
    said = setup_manifest(setup) | robot_manifest(setup) | {"setup": setup.name, "policy_sha256": "-"}
    return Observer(read_manifest(json.dumps(said).encode()), laser)


def test_a_laser_that_is_mounted_elsewhere_is_turned_and_moved() -> None:
    engine = FastEngine(ROOM, 12, auto_reset=False, scenes=draw_scenes(ROOM, range(12)))
    for x, y, yaw, most in ((0.0, 0.0, 2.0, 2e-3), (0.05, 0.02, -1.0, 0.01)):
        lidar = replace(ROOM.robot.lidar, x_m=x, y_m=y, yaw_rad=yaw)
        there = replace(ROOM, robot=replace(ROOM.robot, lidar=lidar))
        observe = observer(ROOM, (x, y, yaw))
        for i in range(12):
            _, odometry, *others = heard(engine, i, 0.0)
            elsewhere = scan_in(there, engine.scene(i), engine.scene(i).start)
            apart = np.abs(observe(elsewhere, odometry, *others) - engine.observations[i])
            assert np.median(apart) <= most
            if x == 0:
                assert apart.max() < 0.2, "beams beside each other"


def test_what_is_no_range_is_nothing_seen_and_what_lacks_is_said_with_its_angle() -> None:
    observe, n = observer(ROOM), 720

    def scanned(ranges: np.ndarray, **other: float) -> np.ndarray:
        values = {"angle_min": 0.0, "angle_increment": 2 * math.pi / n, "range_min": 0.1, "range_max": 12.0} | other
        return observe.sectors(Scan(1.8e9, **values, ranges=ranges))

    plain = np.full(n, 3.0)
    for seen, found in ((np.inf, 6.0), (0.05, 6.0), (20.0, 6.0), (8.0, 6.0), (-np.inf, 0.1), (1.5, 1.5), (np.nan, 3.0)):
        ranges = np.full(n, 3.0)
        ranges[:12] = seen
        if math.isnan(seen):
            ranges[11] = 3.0
        assert scanned(ranges)[0] == found
        assert (scanned(ranges)[1:] == 3.0).all()
    gone = plain.copy()
    gone[24:36] = np.nan
    with pytest.raises(InputError, match=r"invalid \(NaN\) at 15 degrees"):
        scanned(gone)
    with pytest.raises(InputError, match=r"no range at -177, .* and 24 more degrees .* 60 sectors of 6 degrees"):
        scanned(plain[:360])
    with pytest.raises(InputError, match="no range at"):
        scanned(plain[:30], angle_increment=2 * math.pi / 30)
    closed = scanned(np.full(n + 1, 3.0), angle_min=-math.pi)
    assert (closed == 3.0).all(), "as one whose first and last range look the same way, at a stamp of ROS"
    assert (scanned(plain[:360].copy(), angle_increment=2 * math.pi / 360) == 3.0).all(), "coarser, but in every sector"


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"ranges": np.zeros((2, 3))}, "'ranges' has shape"),
        ({"ranges": np.zeros(0)}, "'ranges' has shape"),
        ({"ranges": np.zeros(40_000)}, "'ranges' has shape"),
        ({"ranges": np.zeros(20, dtype=np.int64)}, "'ranges' has shape"),
        ({"angle_min": math.nan}, "'angle_min' = nan"),
        ({"angle_increment": 0.0}, "'angle_increment' = 0"),
        ({"angle_increment": 1.0}, "at most a turn"),
        ({"range_max": 0.1}, "'range_max' = 0.1"),
        ({"stamp_s": math.inf}, "'stamp_s' = inf"),
    ],
)
def test_a_scan_that_is_none_is_refused(changed: dict[str, object], said: str) -> None:
    good = Scan(0.0, 0.0, 2 * math.pi / 20, 0.1, 6.0, np.ones(20))
    with pytest.raises(InputError, match=said):
        replace(good, **changed)
    with pytest.raises(InputError, match="'yaw' = nan"):
        Odometry(0.0, 0.0, 0.0, math.nan, 0.0, 0.0)
    with pytest.raises(InputError, match="'x' = 1000000000"):
        Person(1e9, 0.0)


def test_nobody_is_far_behind_and_of_several_the_nearest_counts() -> None:
    observe = observer(ROOM)
    scan, odometry = Scan(0.0, 0.0, 2 * math.pi / 720, 0.0, 6.0, np.full(720, 6.0)), Odometry(0, 1, 1, 0.5, 0, 0)
    assert observe(scan, odometry, (2, 2))[2:4].tolist() == pytest.approx([0.6, 1.0])
    near, far = Person(2.0, 1.0), Person(-3.0, 1.0)
    both, alone = (observe(scan, odometry, (2, 2), people) for people in ([far, near], [near]))
    np.testing.assert_array_equal(both, alone)
    assert both[2] == pytest.approx(0.1)


def test_motion_of_people_is_seen_from_the_robot() -> None:
    setup = get_setup("crowd_hall")
    observe, lidar = observer(setup), setup.robot.lidar
    scan = Scan(0.0, 0.0, 2 * math.pi / lidar.beams, 0.0, 6.0, np.full(lidar.beams, 6.0))
    seen = observe(scan, Odometry(0, 0, 0, math.pi / 2, 0, 0), (0, 5), [Person(0, 2, 0.5, 0.0), Person(0, -1, 0, 1)])
    layout = [one["name"] for one in setup.observation_layout()]
    by_name = dict(zip(layout, seen.tolist(), strict=True))
    assert by_name["person_distance"] == pytest.approx(0.1)
    assert abs(by_name["person_bearing"]) == pytest.approx(1.0)
    assert by_name["pedestrian_0_along"] == pytest.approx(1.0)
    assert (by_name["pedestrian_1_along"], by_name["pedestrian_1_across"]) == (pytest.approx(0), pytest.approx(-0.5))
    assert (by_name["pedestrian_2_distance"], by_name["pedestrian_2_along"]) == (2.0, 0.0)


def test_speeds_change_at_the_robots_limits_and_stop_at_the_goal() -> None:
    limits = replace(ROOM.robot.limits, v_change=0.5, w_change=1.0)
    setup = replace(ROOM, robot=replace(ROOM.robot, limits=limits))
    base = load_policy("study_room/base").without_critic()
    files = bundle_files(base)
    said = json.loads(files["manifest.json"])
    said["robot"] |= {"v_change": 0.5, "w_change": 1.0}
    content = zipped(files | {"manifest.json": json.dumps(said).encode()})
    scenes = draw_scenes(ROOM, range(50, 54))
    found = compare(setup, base, [Controller.load(content) for _ in scenes], scenes)
    assert found.steps > 40
    assert found.command < CLOSE
    controller = Controller.load(content)
    controller.command = Command(1.0, -2.0)
    scan = Scan(0.0, 0.0, 2 * math.pi / 720, 0.0, 6.0, np.full(720, 6.0))
    assert controller.step(scan, Odometry(0, 1, 1, 0, 1, -2), (1.2, 1)) == Command(0.9, pytest.approx(-1.8))
    assert controller.arrived
    assert controller.laser == (0.0, 0.0, 0.0)
    controller.reset()
    assert controller.command == Command(0.0, 0.0)


def test_a_policy_that_plans_a_path_cannot_be_driven_by_a_scan() -> None:
    setup = get_setup("crowd_office")
    with pytest.raises(ValueError, match="'path_0_x', which nothing on a robot tells"):
        observer(setup)


def test_policies_are_read_by_the_program_that_made_them() -> None:
    """What the controller computes is what a policy does."""
    policy = load_policy("open_field/base")
    assert isinstance(policy, Policy)
    field = get_setup("open_field")
    engine = FastEngine(field, 4, auto_reset=False, scenes=draw_scenes(field, range(4)))
    for i, controller in enumerate(controllers(policy, 4)):
        controller.step(*heard(engine, i, 0.0))
        np.testing.assert_allclose(controller.action, policy.act(engine.observations)[i], atol=1e-5)
