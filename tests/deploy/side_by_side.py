"""A controller beside the engine: the same scenes, step by step, from the engine's own unpooled scans.

Of 200 scenes: `python -m tests.deploy.side_by_side study_room/conditioned 200`.
"""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from desirepath.deploy.controller import Controller
from desirepath.deploy.inputs import Odometry, Person, Scan
from desirepath.learning.policies.bundles import bundle_files, scan_in, zipped
from desirepath.learning.policies.policy import DrivingPolicy, read_policy
from desirepath.learning.shipped_files import resolve
from desirepath.simulation.acting import begin
from desirepath.simulation.fast import FastEngine, make_engine
from desirepath.simulation.scene import Pose, Scene
from desirepath.simulation.scenes import draw_scenes
from desirepath.simulation.setups import Setup, get_setup


@dataclass
class Compared:
    """steps: driven; by: who drove how many; the rest: the largest differences."""

    steps: int = 0
    by: dict[str, int] = field(default_factory=dict)
    observation: float = 0.0
    command: float = 0.0


def heard(engine: FastEngine, i: int, stamp_s: float) -> tuple[Scan, Odometry, tuple[float, float], list[Person]]:
    """What a robot would say in environment i."""
    setup, scene, pose = engine.setup, engine.scene(i), Pose(*map(float, engine.poses[i]))
    v, w = map(float, engine._state.commands[i, 0])
    place = scene.person_poses(np.array([stamp_s]))[0]
    here = replace(scene, person=replace(scene.person, pose=Pose(*map(float, place))))
    odometry = Odometry(stamp_s, pose.x, pose.y, pose.yaw, v, w)
    return scan_in(setup, here, pose, stamp_s), odometry, (scene.goal.x, scene.goal.y), [Person(*place[:2])]


def compare(setup: Setup, policy: DrivingPolicy, controllers: list[Controller], scenes: list[Scene]) -> Compared:
    """Drive the engine by the policy's own rollout; ask the controllers the same."""
    engine, found = make_engine(setup, len(scenes), auto_reset=False, scenes=scenes), Compared()
    steer = begin(policy.rollout_policy, len(scenes), engine)
    actions = np.zeros((len(scenes), 2), dtype=np.float32)
    for step in range(setup.max_steps):
        running = np.flatnonzero(~engine.dones)
        if not len(running):
            break
        actions[running] = steer(engine.observations[running], running)
        commands = {i: controllers[i].step(*heard(engine, i, step * 0.2)) for i in running}
        seen = engine.observations[running].copy()
        engine.step(actions)
        for row, i in enumerate(running):
            told = np.array([commands[i].v, commands[i].w])
            found.observation = max(found.observation, float(np.abs(controllers[i].observation - seen[row]).max()))
            found.command = max(found.command, float(np.abs(told - engine._state.commands[i, 0]).max()))
            found.by[controllers[i].driven_by] = found.by.get(controllers[i].driven_by, 0) + 1
        found.steps += len(running)
    return found


if __name__ == "__main__":
    named, _, weights = sys.argv[1].partition("@")
    stored = read_policy(resolve(named).read_bytes())
    driving = stored.driving(weights)
    there = get_setup(driving.setup)
    content = zipped(bundle_files(stored, weights))
    drawn = draw_scenes(there, range(40_000, 40_000 + int(sys.argv[2])))
    print(asdict(compare(there, driving, [Controller.load(content) for _ in drawn], drawn)))
