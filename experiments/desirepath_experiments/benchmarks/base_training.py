"""How long base training takes on this machine, and what it reaches. Ratios come from one run.

The trainings themselves live in `training_arms.py`.
"""

from __future__ import annotations

import json
import os
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from desirepath.learning.errors import LearningError
from desirepath.learning.td3.base import BaseConfig, base_config
from desirepath_experiments.benchmarks.results import Progress
from desirepath_experiments.benchmarks.training_arms import (
    AVERAGED,
    CONFIRM_SCENES,
    LAST,
    Reached,
    TrainBenchmarkConfig,
    Training,
    take_turns,
    train_ours,
    train_sb3,
    train_unguided,
)

WEIGHTS = {"fast": (LAST, AVERAGED), "unguided": (LAST, AVERAGED), "sb3_fast": (LAST,)}
"""By which weights an arm is judged, whichever get there first: `train_base` considers both, SB3 does not average."""
TRAIN = {"fast": train_ours, "unguided": train_unguided, "sb3_fast": train_sb3}


class _Kept:
    """Finished trainings in a JSON file, so that a long run can be taken up again; nothing is kept without a file."""

    def __init__(self, path: Path | None, settings: dict[str, Any]) -> None:
        self._path, self._settings = path, settings
        self.runs: dict[str, list[Reached]] = {}
        if path is not None and path.exists():
            stored = json.loads(path.read_text(encoding="utf-8"))
            if stored["settings"] != settings:
                raise LearningError(f"{path} holds a benchmark with other settings; name another file or delete it")
            self.runs = {name: [Reached(**entry) for entry in entries] for name, entries in stored["runs"].items()}

    def run(self, trainings: Mapping[str, Callable[[], Training]]) -> list[Reached]:
        """What these reached, in order; those that are not kept yet take turns."""
        missing = {name: training() for name, training in trainings.items() if name not in self.runs}
        if missing:
            self.runs |= take_turns(missing)
            if self._path is not None:
                runs = {name: [asdict(entry) for entry in entries] for name, entries in self.runs.items()}
                self._path.write_text(json.dumps({"settings": self._settings, "runs": runs}), encoding="utf-8")
        return [entry for name in trainings for entry in self.runs[name]]


def benchmark_train(
    config: TrainBenchmarkConfig, progress: Progress | None = None, *, base: BaseConfig | None = None
) -> dict[str, Any]:
    """Processor seconds of training until a base policy reaches 94 %, ours (`fast`) against SB3 on the same engine.

    `fast` is how setups are trained: at first it clones a guide that knows the scene, which SB3 is not given;
    `unguided` is TD3 alone, as SB3's.

    One thread each, in turns of some hundred updates, so that both share the machine with the same others; checks not
    counted. Processor seconds are wall-clock seconds on an idle machine; on a busy one nobody is charged for others'
    work, but for what they leave of caches and clock rate; `per_seed` holds both clocks, `load_average` how busy it
    was. `openblas_coretype`: which kernels NumPy's library was set to use (null: its own choice), which decides more
    than anything else; `torch_cpu_capability` likewise.

    Ours is judged by its last and its averaged weights, whichever are confirmed first, since base training considers
    both; SB3 by its last, since it does not average. `seconds_to_94` and `held_out_success` are medians of the first
    arm named (null if half of the trainings never got there). A ratio whose slow side is null has a lower bound
    beside it, `..._at_least`: its trainings that never got there count with the seconds they had spent.
    """
    chosen = base or base_config(config.setup)
    if chosen.setup != config.setup:
        raise LearningError(f"base.setup = {chosen.setup!r} but setup = {config.setup!r}")
    limits = {name: value for name, value in asdict(config).items() if name not in ("seeds", "arms", "keep")}
    entries_file = _Kept(config.keep, {"base": json.loads(json.dumps(chosen.as_dict())), "config": limits})
    load = [round(value, 2) for value in os.getloadavg()]
    entries = [
        entry
        for seed in range(config.seeds)
        for entry in entries_file.run(
            {f"{arm} {seed}": partial(TRAIN[arm], arm, replace(chosen, seed=seed), config) for arm in config.arms}
        )
    ]
    judged = {arm: _judge(entries, arm) for arm in config.arms}
    seconds = {arm: _median([e.seconds_to_94 for e in reached]) for arm, reached in judged.items()}
    first, fast = config.arms[0], seconds.get("fast")
    never = {
        arm: statistics.median(e.seconds for e in reached) for arm, reached in judged.items() if seconds[arm] is None
    }
    return {
        "setup": config.setup,
        "seeds": config.seeds,
        "seconds_are": "processor time",
        "seconds_to_94": seconds[first],
        "held_out_success": _median([e.held_out_success for e in judged[first]]),
        "seconds_to_94_per_arm": seconds,
        "never_reached": {arm: sum(e.seconds_to_94 is None for e in reached) for arm, reached in judged.items()},
        "judged_by_weights": {arm: WEIGHTS[arm] for arm in config.arms},
        "per_seed": [asdict(entry) for entry in entries],
        "ratio_vs_sb3_fast": _ratio(seconds.get("sb3_fast"), fast),
        "ratio_vs_sb3_fast_at_least": _ratio(never.get("sb3_fast"), fast),
        "network_heads": list(chosen.heads),
        "openblas_coretype": os.environ.get("OPENBLAS_CORETYPE"),
        "torch_cpu_capability": torch.backends.cpu.get_cpu_capability(),
        "load_average": {"before": load, "after": [round(value, 2) for value in os.getloadavg()]},
        "scenes": {"check": config.check_scenes, "confirm": CONFIRM_SCENES, "confirm_scenes_are": "new at every try"},
        "gives_up_after": {"updates": config.max_updates, "seconds": config.max_seconds},
    }


def _judge(entries: Sequence[Reached], arm: str) -> list[Reached]:
    """One entry per seed: the weights that were confirmed first, or those that were trained longest without that."""
    of_arm = [e for e in entries if e.arm == arm and e.weights in WEIGHTS[arm]]
    per_seed = {e.seed: [other for other in of_arm if other.seed == e.seed] for e in of_arm}
    return [min(same, key=lambda e: (e.seconds_to_94 is None, e.seconds)) for same in per_seed.values()]


def _median(values: Sequence[float | None]) -> float | None:
    """The median, where a training that never got there counts as infinitely long."""
    middle = statistics.median(float("inf") if value is None else value for value in values)
    return None if middle == float("inf") else middle


def _ratio(slow: float | None, fast: float | None) -> float | None:
    return None if slow is None or fast is None else slow / fast
