"""A choice made again while it drives, by what the robot knows: the same in the engine and on a robot."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from desirepath.deploy.bundle import MANIFEST, POLICY, Bundle
from desirepath.deploy.controller import Controller
from desirepath.deploy.inputs import Person as ToldPerson
from desirepath.deploy.manifest import BundleError
from desirepath.learning.alignment.each_scene import answers_of, choose_each_scene
from desirepath.learning.policies.bundles import bundle_files, driving_files, zipped
from desirepath.learning.policies.choosing import ChoosingPolicy
from desirepath.learning.policies.deciding import Chooser, DecidesAgain, OnItsWay, Told
from desirepath.learning.policies.policy import PolicyError
from desirepath.learning.policies.robot_choice import RobotChoice
from desirepath.learning.policies.shipped import load_policy
from desirepath.learning.policies.side_by_side import Drivers, SideBySide
from desirepath.npz import from_npz, to_npz
from desirepath.simulation.fast import make_engine, raw_ranges, rollout
from desirepath.simulation.known_world import CELL_M, KnownWorld, ended_beams
from desirepath.simulation.resumed import roll_on
from desirepath.simulation.scene import Pose
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory, arrived
from tests.answers import prefers_distance
from tests.deploy.side_by_side import heard

SETUP = get_setup("study_room")
SCENES = draw_scenes("study_room", range(3_500_000_000, 3_500_000_008))


@pytest.fixture(scope="module")
def own() -> ChoosingPolicy:
    return choose_each_scene(answers_of(prefers_distance(12)), kept=4)


@pytest.fixture(scope="module")
def files(own: ChoosingPolicy) -> dict[str, bytes]:
    return driving_files(own)


def cut(driven: Trajectory, steps: int) -> Trajectory:
    parts = {name: getattr(driven, name)[:steps] for name in ("observations", "actions", "rewards", "dones")}
    return replace(driven, poses=driven.poses[: steps + 1], next_observations=driven.next_observations[:steps], **parts)


def test_side_by_side_each_acts_as_alone(own: ChoosingPolicy) -> None:
    scenes = [scene for scene in SCENES for _ in own.policies]
    places = np.tile(np.arange(len(own.policies)), len(SCENES))
    together = rollout(SETUP, Drivers(own.side_by_side, places), scenes)
    for driven, place, scene in zip(together, places, scenes, strict=True):
        (alone,) = rollout(SETUP, own.policies[place].rollout_policy, [scene])
        np.testing.assert_allclose(driven.poses, alone.poses, atol=1e-3)


def test_policies_of_several_shapes_do_not_act_side_by_side() -> None:
    policies = [load_policy("study_room/base"), load_policy("open_field/base")]
    with pytest.raises(PolicyError, match="2 network shapes"):
        SideBySide(policies)


@pytest.mark.parametrize("steps", [0, 1, 7])
def test_who_is_on_its_way_goes_on_as_it_did(own: ChoosingPolicy, steps: int) -> None:
    base = SideBySide(own.policies[:1])
    (whole,) = rollout(SETUP, Drivers(base, np.zeros(1, dtype=np.int64)), SCENES[:1])
    on = roll_on(SETUP, base.begin(np.zeros(2, dtype=np.int64)), 2, cut(whole, steps))
    for driven in on:
        assert driven.outcome == whole.outcome
        np.testing.assert_allclose(driven.poses, whole.poses, atol=1e-4)
        np.testing.assert_allclose(driven.next_observations, whole.next_observations, atol=1e-4)


def test_a_robot_knows_walls_where_beams_ended_but_not_its_person() -> None:
    scene, known = SCENES[0], KnownWorld()
    person, pose = scene.person, scene.start
    ended = ended_beams(SETUP, pose, raw_ranges(SETUP, scene, pose))
    known.see(ended, SETUP.robot.lidar.beams, [(person.pose.x, person.pose.y)], person.radius)
    seen = known.map_around([pose, scene.goal], SETUP.robot.lidar.range_m)
    at = np.argwhere(seen.occupied) * CELL_M + seen.origin + CELL_M / 2
    solids = np.min([solid.distance_m(at[:, 0], at[:, 1]) for solid in scene.solids()], axis=0)
    assert len(at) > 50
    assert solids.max() < CELL_M
    assert np.hypot(at[:, 0] - person.pose.x, at[:, 1] - person.pose.y).min() > person.radius


def test_by_its_own_senses_it_arrives_and_hardly_changes_its_mind(own: ChoosingPolicy) -> None:
    decides = DecidesAgain(Chooser(own.setup, own.side_by_side, own.gains))
    driven = rollout(SETUP, decides, SCENES)
    assert arrived(driven).all()
    assert any(choices[0] > 0 for choices in decides.choices)
    assert np.mean([np.count_nonzero(np.diff(choices)) for choices in decides.choices]) <= 1
    assert [len(choices) for choices in decides.choices] == [(len(one.actions) + 4) // 5 for one in driven]


def test_who_drives_goes_on_unless_another_is_better(own: ChoosingPolicy) -> None:
    good, bad = rollout(SETUP, own.policies[0].rollout_policy, SCENES[:2])
    chooser = Chooser(own.setup, own.side_by_side, lambda _, others: np.full(len(others), -1.0))
    ways = [good] * len(own.side_by_side)
    assert chooser.best(ways, 2) == 2
    lost = replace(bad, outcome=type(bad.outcome).TIMEOUT)
    assert chooser.best([good, lost, lost], 1) == 0
    assert chooser.best([lost, lost, good], 1) == 2
    assert chooser.best([lost, lost, lost], 1) == 0
    assert chooser.best([good, good, good], 1, stands=True) == 0


def test_whoever_walks_is_foreseen_to_walk_on(own: ChoosingPolicy) -> None:
    asked: list[Trajectory] = []

    def gains(usual: Trajectory, others: Sequence[Trajectory]) -> np.ndarray:
        asked.append(usual)
        return np.full(len(others), -1.0)

    drive = OnItsWay(Chooser(own.setup, own.side_by_side, gains), (3.0, 0.0), SETUP.goal_radius_m)
    walls = np.array([[5.0, 0.1 * k] for k in range(-30, 30)])
    drive.see(
        Pose(0.0, 0.0), walls, 60, [Told(1.0, 2.0, -0.5, 0.0)], np.zeros(SETUP.observation_size, dtype=np.float32)
    )
    drive.ask()()
    (usual,) = asked
    person = usual.scene.people_at(np.array([0.0, 2.0, 60.0]))[0]
    np.testing.assert_allclose(person[0], [1.0, 2.0], atol=1e-6)
    np.testing.assert_allclose(person[1], [0.0, 2.0], atol=1e-6)
    np.testing.assert_allclose(person[2], [-3.0, 2.0], atol=1e-6)
    assert np.diff(usual.next_observations[:, 3]).any()  # what it would observe moves


class Foresees(Chooser):
    """Keeps what would be done."""

    def __init__(self, setup: str, policies: SideBySide) -> None:
        super().__init__(setup, policies, lambda usual, others: np.zeros(len(others)))
        object.__setattr__(self, "ways", [])

    def best(self, ways: Sequence[Trajectory], driving: int, *, stands: bool = False) -> int:
        self.ways.extend(ways)  # type: ignore[attr-defined]
        return 0


def on_its_way(own: ChoosingPolicy, told: Sequence[Sequence[Told]]) -> Trajectory:
    """What the base policy would do after so many steps, in which the robot was told of these people."""
    foresees = Foresees(own.setup, own.side_by_side)
    drive = OnItsWay(foresees, (3.0, 0.0), SETUP.goal_radius_m)
    walls = np.array([[5.0, 0.1 * k] for k in range(-30, 30)])
    for k, people in enumerate(told):
        if k:
            drive.acted(np.array([-0.9, 0.0]))
        drive.see(Pose(0.001 * k, 0.0), walls, 60, people, np.zeros(SETUP.observation_size, dtype=np.float32))
    drive.ask()()
    return foresees.ways[0]  # type: ignore[attr-defined]


def test_whoever_jumped_or_was_not_told_of_is_foreseen_since_then(own: ChoosingPolicy) -> None:
    walks = [[Told(2.0 - 0.1 * k, 2.0, -0.5)] for k in range(6)]
    for before in ([[]], [[Told(-4.0, 1.0)]]):
        usual = on_its_way(own, before + walks)
        assert usual.scene.walk is not None
        people = usual.scene.people_at(np.array([0.0, 1.2, 2.2]))[0]
        np.testing.assert_allclose(people, [[2.0, 2.0], [1.5, 2.0], [1.0, 2.0]], atol=0.02)


def test_nobody_is_where_policies_observe_nobody(own: ChoosingPolicy) -> None:
    usual = on_its_way(own, [[]])
    assert usual.scene.person.pose == Pose(-6.0, 0.0, usual.scene.person.pose.yaw)


def test_the_map_stays_small_whoever_is_told_of_and_wherever_it_is_to_go(own: ChoosingPolicy) -> None:
    usual = on_its_way(own, [[Told(9_000.0, -9_000.0)]])
    seen = usual.scene.seen  # type: ignore[attr-defined]  # as a robot knows it
    assert max(seen.size_m) < 30


def test_everybody_who_is_told_of_leaves_no_wall(own: ChoosingPolicy) -> None:
    known = KnownWorld()
    beside = np.array([[2.0, 0.1], [2.1, 0.0], [4.0, 0.0]])
    known.see(beside, 3, [(0.0, 3.0), (2.2, 0.0)], 0.3)
    seen = known.map_around([Pose(0.0, 0.0)], 6.0)
    assert seen.occupied.sum() == 1


def test_a_long_drive_is_judged_by_its_last_minute(own: ChoosingPolicy) -> None:
    usual = on_its_way(own, [[Told(1.0, 2.0)]] * 700)
    assert 300 < len(usual.actions) <= 300 + 200


def test_in_the_open_what_is_foreseen_comes_true() -> None:
    """Few beams end there, and the edge of what is known is no wall."""
    setup, base = get_setup("open_field"), SideBySide([load_policy("open_field/base").without_critic()])
    apart = []
    for scene in draw_scenes("open_field", range(3_500_000_000, 3_500_000_004)):
        (true,) = rollout(setup, Drivers(base, np.zeros(1, dtype=np.int64)), [scene])
        foresees = Foresees(setup.name, base)
        drive = OnItsWay(foresees, (scene.goal.x, scene.goal.y), scene.goal_radius)
        ranges = raw_ranges(setup, scene, scene.start)
        ended = ended_beams(setup, scene.start, ranges)
        person = scene.person.pose
        drive.see(scene.start, ended, len(ranges), [Told(person.x, person.y)], true.observations[0])
        drive.ask()()
        (way,) = foresees.ways  # type: ignore[attr-defined]
        n = min(len(true.poses), len(way.poses))
        apart.append(float(np.linalg.norm(way.poses[:n, :2] - true.poses[:n, :2], axis=1).max()))
    assert np.median(apart) < 0.6


def test_who_takes_over_is_not_stuck_where_another_was(files: dict[str, bytes]) -> None:
    controller = Controller.load(zipped(files))
    engine = make_engine(SETUP, 1, auto_reset=False, scenes=SCENES[:1])
    said = heard(engine, 0, 0.0)
    for _ in range(100):  # it comes no nearer
        controller.step(*said)
    controller.drive_by(1)
    controller.step(*said)
    assert controller.driven_by == "policy"


def test_whoever_fails_to_hear_ends_the_choice_and_not_the_drive(files: dict[str, bytes]) -> None:
    controller = Controller.load(zipped(files))
    controller.decider = RobotChoice.read(controller.content)
    controller.decider.stepped = lambda *_: 1 / 0  # type: ignore[method-assign]
    controller.step(*heard(make_engine(SETUP, 1, auto_reset=False, scenes=SCENES[:1]), 0, 0.0))
    assert (controller.decider, controller.undecided) == (None, "division by zero")


def test_a_robot_chooses_as_the_engine_does(own: ChoosingPolicy, files: dict[str, bytes]) -> None:
    decides = DecidesAgain(Chooser(own.setup, own.side_by_side, own.gains))
    simulated = rollout(SETUP, decides, SCENES)
    controller = Controller.load(zipped(files))
    assert controller.choices == len(own.policies)
    controller.decider = RobotChoice.read(controller.content)
    same = 0
    for scene, choices, driven in zip(SCENES, decides.choices, simulated, strict=True):
        engine, chosen = make_engine(SETUP, 1, auto_reset=False, scenes=[scene]), []
        controller.reset()
        for step in range(len(driven.actions) + 20):
            controller.step(*heard(engine, 0, step * 0.2))
            if (ask := controller.ask_who_drives()) is not None:
                controller.drive_by(ask())
                chosen.append(controller.chosen)
            engine.step(controller.action[None])
            if engine.dones[0]:
                break
        assert engine.outcomes[0] == 1
        same += chosen[:1] == choices[:1]
    assert same >= 7


def test_nothing_of_a_robots_choice_is_lost_on_who_looks_ahead(files: dict[str, bytes]) -> None:
    controller = Controller.load(zipped(files))
    controller.decider = RobotChoice.read(controller.content)
    assert controller.copy().decider is None


def test_who_drives_is_asked_with_the_first_step_and_every_second(files: dict[str, bytes]) -> None:
    controller = Controller.load(zipped(files))
    assert controller.ask_who_drives() is None
    controller.decider = RobotChoice.read(controller.content)
    engine = make_engine(SETUP, 1, auto_reset=False, scenes=SCENES[:1])
    scan, odometry, goal, _ = heard(engine, 0, 0.0)
    asked = []
    for _ in range(12):
        controller.step(scan, odometry, goal, [ToldPerson(30.0, 30.0)])
        asked.append(controller.ask_who_drives() is not None)
    assert [step for step, one in enumerate(asked) if one] == [0, 5, 10]
    controller.drive_by(2)
    controller.reset()
    assert controller.chosen == 0
    with pytest.raises(IndexError, match="place = 9: the bundle has 5 policies"):
        controller.drive_by(9)


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("policies", 3, "must be a list of 2 to 100"),
        ("policies", [{"actor": [0]}] * 2, "must be an object with shape, actor and recovery"),
        ("policies", [{"actor": [7_000], "recovery": [], "shape": {}}] * 2, "layer_7000 is no layer"),
        ("policies", [{"actor": ["0"], "recovery": [], "shape": {}}] * 2, "is no layer"),
        ("policies", [{"actor": [0, 1], "recovery": [], "shape": {}}] * 2, "a network of policies"),
    ],
)
def test_a_choice_that_is_none_is_refused(files: dict[str, bytes], field: str, value: object, said: str) -> None:
    header, arrays = from_npz(files[POLICY])
    content = to_npz({**header, field: value}, arrays)
    manifest = json.loads(files[MANIFEST]) | {"policy_sha256": hashlib.sha256(content).hexdigest()}
    with pytest.raises(BundleError, match=said):
        Bundle.read(zipped({MANIFEST: json.dumps(manifest).encode(), POLICY: content}))


def test_a_file_whose_shared_layers_would_fill_the_memory_is_refused(
    own: ChoosingPolicy, files: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("desirepath.deploy.bundle.MOST_NUMBERS", 100_000)
    with pytest.raises(BundleError, match="more than 100,000 weights together"):
        Bundle.read(zipped(files))
    monkeypatch.setattr("desirepath.learning.policies.choosing.MOST_NUMBERS", 100_000)
    with pytest.raises(PolicyError, match="at most 100,000"):
        replace(own)


def test_what_is_exported_holds_all_that_drives(own: ChoosingPolicy) -> None:
    files = bundle_files(own)
    assert len(zipped(files)) < 4_000_000
    assert json.loads(files[MANIFEST])["chooses"]
