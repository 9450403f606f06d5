"""What an importance ranking shows (chapter 8): rollouts up to where the robot halts, and what each object scored.

Here are making, storing and reading them. Which scenes they are drawn in is not said here; who ranks is the study's,
how rankings are compared the report's.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from desirepath.explain.in_sight import halts_in_sight
from desirepath.explain.methods import AttributionError, Command, Method
from desirepath.explain.sight import sight_of, thing_names
from desirepath.npz import Arrays, npz_header
from desirepath.simulation.acting import ActFunction, EpisodicPolicy
from desirepath.simulation.fast import Floats, rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import CONTROL_DT_S, get_setup
from desirepath.simulation.stored import StoredArrays
from desirepath.simulation.trajectory import STORED, Outcome, Trajectory

if TYPE_CHECKING:
    from desirepath.explain.attribution import Actor

DRIVE_S = 3.0  # chapter 8: then the robot halts
ATTENTION = ("spatial", "temporal")
PARTS = 1_000  # that a weight of attention is stored in


@dataclass(frozen=True)
class ExplainedRollout:
    """One scenario with T steps until the halt.

    trajectory: T actions, T + 1 poses. things: the objects that are ranked, the scene's obstacles by the names of
    `thing_names`. scores: (T + 1, things) float32 in [0, 1], row k at k * dt; the last row is what is shown while the
    robot stands, and the order that rankings are compared with. practice: never analysed. attention: what a policy with
    attention looked at, (T + 1, sectors) and (T + 1, rays) weights that sum to 1; then the things are people.
    """

    trajectory: Trajectory
    things: tuple[str, ...]
    scores: Floats
    practice: bool = False
    attention: tuple[Floats, Floats] | None = None

    @property
    def at_halt(self) -> dict[str, float]:
        """Thing -> its score where the robot stands."""
        return {thing: round(float(score), 4) for thing, score in zip(self.things, self.scores[-1], strict=True)}


@dataclass(frozen=True)
class RankingSet(StoredArrays):
    """Explained rollouts of one policy in scenes of one setup. policy: its name. method `attention`: scores are what a
    policy with attention gave to each of the people, in all that it does."""

    setup: str
    rollouts: tuple[ExplainedRollout, ...]
    policy: str
    method: Method | Literal["attention"]
    command: Command | Literal["all"]

    def __len__(self) -> int:
        return len(self.rollouts)

    noun, file_format, raises = "ranking set", "desirepath-ranking-set-1", AttributionError

    def to_parts(self) -> tuple[dict[str, object], Arrays]:
        header: dict[str, object] = {
            "setup": self.setup,
            "policy": self.policy,
            "method": self.method,
            "command": self.command,
            "rollouts": [
                {
                    "scene": each.trajectory.scene.as_dict(),
                    "things": list(each.things),
                    "practice": each.practice,
                    "dt": each.trajectory.dt,
                }
                for each in self.rollouts
            ],
        }
        arrays = {name: np.concatenate([getattr(each.trajectory, name) for each in self.rollouts]) for name in STORED}
        steps = np.array([len(each.trajectory.actions) for each in self.rollouts], dtype=np.int32)
        scores = np.concatenate([each.scores.ravel() for each in self.rollouts]).astype(np.float32)
        attended = [each.attention for each in self.rollouts if each.attention is not None]
        for number, name in enumerate(ATTENTION if attended else ()):
            weights = np.concatenate([both[number] for both in attended])
            arrays[name] = np.rint(PARTS * weights).astype(np.uint16)
        return header, {"steps": steps, "scores": scores, **arrays}

    @classmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> RankingSet:
        rollouts, first, score = [], 0, 0
        for k, (stored, steps) in enumerate(zip(header["rollouts"], arrays["steps"].tolist(), strict=True)):
            rows, poses = slice(first, first + steps), slice(first + k, first + k + steps + 1)
            cut: dict[str, Any] = {name: arrays[name][poses if name == "poses" else rows] for name in STORED}
            things = tuple(str(thing) for thing in stored["things"])
            scores = arrays["scores"][score : score + (steps + 1) * len(things)].reshape(steps + 1, len(things))
            scene = Scene.from_dict(stored["scene"])
            trajectory = Trajectory(scene, Outcome.RUNNING, **cut, dt=float(stored["dt"]))
            looked = [(arrays[name][poses] / PARTS).astype(np.float32) for name in ATTENTION if name in arrays]
            attention = (looked[0], looked[1]) if looked else None
            rollouts.append(ExplainedRollout(trajectory, things, scores, bool(stored["practice"]), attention))
            first, score = first + steps, score + scores.size
        return cls(header["setup"], tuple(rollouts), header["policy"], header["method"], header["command"])


def is_ranking_set(data: bytes) -> bool:
    """Whether a file holds explained rollouts rather than queries."""
    try:
        return npz_header(data).get("format") == RankingSet.file_format
    except (KeyError, TypeError, ValueError):
        return False


def explain_rollout(
    actor: Actor,
    act: ActFunction | EpisodicPolicy,
    scene: Scene,
    *,
    method: Method = "saliency",
    command: Command = "speed",
    drive_s: float = DRIVE_S,
) -> ExplainedRollout:
    """Roll a policy out in a scene and explain every moment until it halts. actor: what `act` usually acts by.

    Raises AttributionError where the rollout is over before the halt: then there is none to explain.
    """
    steps = round(drive_s / CONTROL_DT_S)
    whole = rollout(get_setup(scene.setup), act, [scene], max_steps=steps + 1)[0]
    if len(whole.actions) <= steps:
        raise AttributionError(
            f"scene {scene.seed}: the rollout is over ({whole.outcome.name.lower()}) after {whole.duration_s:.1f} s, "
            f"before the halt at {drive_s:.1f} s; leave the scene out"
        )
    from desirepath.explain.attribution import explain  # torch and captum: not where a set is only read

    explained = explain(actor, sight_of(whole), method=method, command=command)
    things = tuple(thing_names(scene)[: len(scene.obstacles)])
    scores = explained.scores[:, : len(things)].astype(np.float32)
    return ExplainedRollout(_cut(whole, steps), things, scores)


def ranking_set(
    actor: Actor,
    act: ActFunction | EpisodicPolicy,
    scenes: Iterable[Scene],
    practice: Iterable[Scene],
    *,
    count: int,
    practised: int,
    policy: str,
    method: Method = "saliency",
    command: Command = "speed",
) -> RankingSet:
    """Explained rollouts of a policy in the first `count` of the scenes in which it halts in sight of the person, and
    in the first `practised` of others for practice. Raises AttributionError where there are fewer such scenes.
    """
    rollouts: list[ExplainedRollout] = []
    for some, wanted, practising in ((scenes, count, False), (practice, practised, True)):
        candidates = _in_sight(actor, act, some, method, command)
        chosen = [replace(each, practice=practising) for each in islice(candidates, wanted)]
        if len(chosen) < wanted:
            raise AttributionError(
                f"scenes: the robot still drives after {DRIVE_S:g} s and halts in sight in {len(chosen)} of them; a "
                f"ranking set of {wanted} needs more scenes"
            )
        rollouts += chosen
    return RankingSet(rollouts[0].trajectory.scene.setup, tuple(rollouts), policy, method, command)


def _in_sight(
    actor: Actor, act: ActFunction | EpisodicPolicy, scenes: Iterable[Scene], method: Method, command: Command
) -> Iterator[ExplainedRollout]:
    """Rollouts that halt where the person sees the robot; others say nothing to whoever ranks."""
    for scene in scenes:
        with suppress(AttributionError):  # it was over before
            explained = explain_rollout(actor, act, scene, method=method, command=command)
            if halts_in_sight(explained.trajectory):
                yield explained


def _cut(whole: Trajectory, steps: int) -> Trajectory:
    """Its first steps; it is running then."""
    return replace(
        whole,
        outcome=Outcome.RUNNING,
        poses=whole.poses[: steps + 1],
        observations=whole.observations[:steps],
        actions=whole.actions[:steps],
        rewards=whole.rewards[:steps],
        next_observations=whole.next_observations[:steps],
        dones=whole.dones[:steps],
        self_intersections=0,
    )
