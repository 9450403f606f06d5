"""Cards: what every stored artefact says about itself, beside its file. Where shipped ones lie: `shipped.py`."""

from __future__ import annotations

import hashlib
import json
import subprocess
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from desirepath.installed import ROOT
from desirepath.learning.errors import LearningError
from desirepath.simulation.social_metrics import COLUMNS

SOCIAL = tuple(COLUMNS)
"""Of the numbers of an episode on cards, the field's social metrics (`simulation/social_metrics.py`)."""
DEPARTURES = {
    "progress": "Base training adds +1 per metre of progress towards the goal; the thesis does not. It enters no "
    "alignment reward, no ensemble training and no evaluation.",
    "smoothness": "In the last updates of base training the actor's loss also holds a weight times the mean squared "
    "turn rate (in [-1, 1]), which keeps policies from wobbling; the thesis has no such term. It enters no reward, no "
    "ensemble training and no alignment.",
    "guide": "While nothing is learned yet, a planner that knows the scene drives in part of the environments instead "
    "of chance. The actor imitates it before a critic judges, where the card's settings have `cloned`, and is drawn to "
    "what it does in the updates after that. Where it is to the end (`last_guidance`), trainings that go on from the "
    "policy draw the new one to it as much; nothing else has the guide.",
    "randomised": "Robots get wrong in training what real ones do: lidar noise, delay, slip and slow wheels, up to "
    "`RANDOMISED` in simulation/disturbed.py, drawn anew in every episode; the thesis trains without.",
    "heads": "Actor and critic heads are 128, 128 instead of 400, 300, for speed; the wider ones were not trained "
    "here.",
    "environments": "Many environments in a fast kinematic engine instead of one in iGibson; updates per step differ.",
    "average": "The kept weights are the best of several checkpoints, as they are or averaged over recent updates, "
    "chosen on scenes that no reported number uses.",
    "ensemble_start": "Members start from a buffer regenerated from the base policy and the seed, not from the one of "
    "its training. Each makes as many updates at a time as it has environments, apart meanwhile from the others as "
    "they were before.",
    "ensemble_choice": "A member is the running average of its actor's weights at one of several checkpoints. Of those "
    "with enough success on the selection scenes the ones were kept that together differ most; the thesis keeps the "
    "last weights.",
    "pair_filters": "Besides collisions, self-intersections and timeouts, pairs are dropped that are too long to watch "
    "or that a person could hardly tell apart.",
    "instant": "Instead of an alignment: a policy trained for all preference weights beforehand is conditioned on "
    "those that the answers speak for.",
    "conditioned": "Not in the thesis: nine preference weights are further inputs of the policy; aligning it takes no "
    "training.",
    "recovery": "While a robot comes no nearer to its goal (6 s) the base policy acts, then the policy at zero "
    "weights, until it is half a metre nearer; at last it stands. The thesis's policies have no memory.",
    "added": "After training, on selection scenes: `clearance` alone enters more strongly than it was learned, and who "
    "prefers it slow beside the person is slowed down there by a rule, forwards and turning alike. The rule is no part "
    "of the network, so exports to ONNX and Stable-Baselines3 do not have it.",
    "progress_conditioned": "Its training adds +1 per metre of progress and a cost per step, and other rewards for "
    "goal, collision and self-intersection than the setup's (config: stakes); evaluation uses none of these.",
    "conditioning_search": "A search adds offsets to the preference weights, linear in how far goal and person are, so "
    "that ways grow shorter at what is preferred; it is shown only where it is better on held-out scenes. Nothing is "
    "trained.",
    "varied": "Pairs are trajectories of a conditioned policy at drawn preference weights instead of two ensemble "
    "members, chosen so that measures vary and vary independently.",
    "manners": "Pairs are trajectories of many policies, most of them driven in a drawn manner (slower, swerving, "
    "hesitating, keeping to free space, ...), chosen so that answers tell different people apart.",
    "free_form": "The answers are about something that is not among the nine objectives: weights of a step basis are "
    "learned from them, and of a library the policy that is expected to gain most by two posteriors is taken; behind "
    "it, that one is trained on by the reward per step, less what it has reached, so that waiting pays nobody.",
    "each_scene": "Instead of one policy: in each scene, whose map and person are known, the base policy and some of "
    "the policy library are rolled out, and that one drives of whose rollout both posteriors together expect most, "
    "less 0.2 standard deviations (until 2026-11-27: 0.4); the base policy where they expect nothing. Nothing is "
    "trained.",
    "path_weights": "Not in the thesis: what a conditioned policy measures at weights drawn from the prior, to read "
    "weights from drawn paths.",
    "step_basis": "Not in the thesis: numbers of a step of which weighted sums come near random rewards of observation "
    "and action; nobody's answers have a part in it.",
    "policy_library": "Not in the thesis: policies that were trained on from the base policy by orthogonal weights of "
    "a step basis, and the conditioned policy at settings; which one is somebody's is chosen by what they answer.",
    "fine_tuning": "Instead of the thesis's lambda: half of each batch is new experience, "
    "the preference's weight starts from what is at stake in an episode and follows success on the selection scenes, "
    "lost checkpoints are gone back from, and every step costs 0.1, so that waiting is not free.",
}


STORED_AS = {
    "smoothness_penalty": "calm_weight",
    "smoothing_updates": "calm_updates",
    "smoothing_learning_rate": "calm_learning_rate",
    "reward_weights": "stakes",
    "trajectories": "drives",
    "settings": "wants",
    "response_models": "habits",
}
"""Setting -> its key on cards, of those renamed since the first release. Cards, and whatever is named by a hash of
settings, keep their keys: what was shipped can be made again, byte for byte."""


def stored_config(config: Any) -> dict[str, Any]:
    """A configuration (a dataclass) as cards hold it."""

    def stored(value: Any) -> Any:
        return {STORED_AS.get(k, k): stored(v) for k, v in value.items()} if isinstance(value, dict) else value

    renamed: dict[str, Any] = stored(asdict(config))
    return renamed


def read_config(stored: Mapping[str, Any]) -> dict[str, Any]:
    """Settings by their present names, of what `stored_config` wrote, ever; lists become tuples again."""
    names = {key: name for name, key in STORED_AS.items()}
    return {names.get(k, k): tuple(v) if isinstance(v, list) else v for k, v in stored.items()}


@dataclass(frozen=True)
class Card:
    """Everything needed to judge an artefact and to make it again.

    command: what made it. commit: the source's git commit, `-dirty` if simulation or learning differed from it.
    scenes: which scene seeds chose it and which reported on it. results: numbers on the reporting scenes.
    parents: names and sha256 of the artefacts it was made from. departures: from the thesis, in sentences.
    """

    kind: str
    name: str
    setup: str
    file: str
    sha256: str
    command: str
    seed: int
    commit: str
    config: dict[str, Any]
    scenes: dict[str, Any]
    results: dict[str, Any]
    parents: dict[str, str] = field(default_factory=dict)
    departures: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def save(self, path: Path) -> None:
        """Numbers to five digits; without indentation, which was half of it."""
        path.write_text(json.dumps(short(asdict(self)), indent=0, sort_keys=True) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> Card:
        """Raises LearningError for a missing or incomplete card."""
        try:
            return cls(**json.loads(path.read_text(encoding="utf-8")))
        except OSError as problem:
            raise LearningError(f"cannot read card {path}: {problem.strerror}") from None
        except (TypeError, json.JSONDecodeError) as problem:
            raise LearningError(f"card {path} is incomplete or no card: {problem}") from None


def short(value: Any) -> Any:
    """The value with every float in it to five digits."""
    if isinstance(value, float):
        return float(f"{value:.5g}")
    if isinstance(value, dict):
        return {key: short(item) for key, item in value.items()}
    return [short(item) for item in value] if isinstance(value, list | tuple) else value


def file_sha256(path: Path) -> str:
    """sha256 of a file's bytes."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def card_path(artefact: Path) -> Path:
    """`base.npz` -> `base.card.json`."""
    return artefact.with_suffix(".card.json")


def source_commit() -> str:
    """The git commit of this source tree, with `-dirty` where simulation or learning differ; `unknown` without git."""

    def git(*words: str) -> str:
        done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=True)
        return done.stdout.strip()

    try:
        commit = git("rev-parse", "HEAD")
        changed = git("status", "--porcelain", "--", "backend/desirepath/simulation", "backend/desirepath/learning")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{commit}-dirty" if changed else commit
