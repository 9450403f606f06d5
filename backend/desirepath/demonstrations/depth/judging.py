"""How a depth controller does: success, collisions and timeouts by person mode, and how closely it follows what was
shown (t* together with f, section 3.5.4); with person, furniture or both taken away (section 3.5.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.frechet import Deviation, deviation
from desirepath.demonstrations.depth.depth_controller import DepthController
from desirepath.demonstrations.depth.episodes import Episodes, InOrder, people_of
from desirepath.demonstrations.depth.states import goals_of
from desirepath.demonstrations.depth.training import MakeSenses
from desirepath.simulation.fast import make_engine, replay
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Outcome, Trajectory

HOME = get_setup("home")

REMOVALS = ("nothing", "person", "furniture", "both")
SPARSE = 2  # every so many poses are compared


@dataclass(frozen=True)
class DepthRollouts:
    """outcomes (n,), paths: (steps + 1, 2) metres and actions (steps, 2) each, in the order of the episodes."""

    outcomes: NDArray[np.int8]
    paths: list[NDArray[np.float64]]
    actions: list[NDArray[np.float32]]
    modes: tuple[str, ...]

    def rates(self, mode: str | None = None) -> dict[str, float | int]:
        """Success, collision and timeout rates, of one mode or of all."""
        chosen = np.array([mode is None or own_mode == mode for own_mode in self.modes], dtype=bool)
        outcomes = self.outcomes[chosen]
        return {
            "n": int(chosen.sum()),
            "success_rate": float((outcomes == Outcome.SUCCESS).mean()) if len(outcomes) else 0.0,
            "collision_rate": float((outcomes == Outcome.COLLISION).mean()) if len(outcomes) else 0.0,
            "timeout_rate": float((outcomes == Outcome.TIMEOUT).mean()) if len(outcomes) else 0.0,
        }


def without(episodes: Episodes, removed: str) -> Episodes:
    """The same episodes with the person, the furniture (all but walls) or both taken away. Raises ValueError."""
    if removed not in REMOVALS:
        raise ValueError(f"removed = {removed!r}: known are {', '.join(REMOVALS)}")
    scenes, modes = episodes.scenes, episodes.modes
    if removed in ("furniture", "both"):
        scenes = tuple(replace(s, obstacles=tuple(o for o in s.obstacles if o.kind == "wall")) for s in scenes)
    if removed in ("person", "both"):
        scenes, modes = tuple(replace(s, walk=None) for s in scenes), ("absent",) * len(scenes)
    return Episodes(scenes, modes)


def roll_out_depth(controller: DepthController, make: MakeSenses, episodes: Episodes) -> DepthRollouts:
    """Every episode once."""
    n = len(episodes)
    engine = make_engine(HOME, n, pool=InOrder(episodes))
    senses = make(episodes.sights(), True)
    outcomes = np.full(n, int(Outcome.RUNNING), dtype=np.int8)
    paths = [[engine.poses[i, :2].copy()] for i in range(n)]
    commands: list[list[NDArray[np.float32]]] = [[] for _ in range(n)]
    begins = np.ones(n, dtype=bool)
    for _ in range(HOME.max_steps):
        rows = engine.rows
        states = senses.states(engine.poses, goals_of(rows), people_of(rows), engine.seeds, begins)
        actions = controller.act(states)
        senses.acted(actions)
        before = engine.poses[:, :2].copy()
        engine.step(actions)
        begins = engine.dones.copy()
        for i in np.flatnonzero(outcomes == Outcome.RUNNING):
            # An ended environment already stands at its next start.
            paths[i].append(before[i] if begins[i] else engine.poses[i, :2].copy())
            commands[i].append(actions[i].copy())
            if begins[i]:
                outcomes[i] = engine.outcomes[i]
        if (outcomes != Outcome.RUNNING).all():
            break
    return DepthRollouts(outcomes, list(map(np.array, paths)), list(map(np.array, commands)), episodes.modes)


def depth_trajectories(controller: DepthController, make: MakeSenses, scenes: Sequence[Scene]) -> list[Trajectory]:
    """Its rollouts in these homes, people standing or walking as the scenes have them; as any policy's are kept."""
    if not scenes:
        return []
    episodes = Episodes(tuple(scenes), ("replayed",) * len(scenes))
    return replay(HOME, scenes, roll_out_depth(controller, make, episodes).actions)


def judge_followed(rollouts: DepthRollouts, shown: Sequence[Sequence[NDArray[np.floating]]]) -> list[Deviation]:
    """Of every rollout: t* and f against that of its scene's demonstrated paths that it follows best."""
    deviations = []
    for path, others in zip(rollouts.paths, shown, strict=True):
        sparse = path[::SPARSE] if len(path) > 2 * SPARSE else path
        apart = [deviation(sparse, np.asarray(other, dtype=np.float64)[::SPARSE, :2], exact_m=1e-3) for other in others]
        deviations.append(max(apart, key=lambda of: of.cost))
    return deviations
