"""How long base training takes on this machine, and what it reaches. Ratios come from one run.

The trainings themselves live in `training_arms.py`.
"""

from __future__ import annotations

import json
import os
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from desirepath.learning.errors import LearningError
from desirepath.learning.td3.base import BaseConfig
from desirepath.simulation.setups import get_setup
from desirepath_experiments.benchmarks.training_arms import (
    AVERAGED,
    CONFIRM_SCENES,
    LAST,
    Reached,
    TrainBenchmarkConfig,
    Training,
    pybullet_seconds_per_step,
    taking_turns,
    train_ours,
    train_sb3,
)

ARMS = ("fast", "sb3_fast", "sb3_pybullet")
WEIGHTS = {"fast": (LAST, AVERAGED), "sb3_fast": (LAST,), "sb3_pybullet": (LAST,)}
"""By which weights an arm is judged, whichever get there first: `train_base` considers both, SB3 does not average."""
Train = Callable[[str, BaseConfig, TrainBenchmarkConfig], Training]
IN_TURNS = ("fast", "sb3_fast")  # PyBullet's arm uses the same global random stream as SB3's: it follows alone


RANDOM_TRANSITIONS_ALONE = 10_000  # of one environment, at most: it has seen some twenty episodes by then


def alone(base: BaseConfig) -> BaseConfig:
    """As Stable-Baselines3's users begin: one environment, one update per step, one noise level (the middle one)."""
    middle = (base.exploration[0] * base.exploration[1]) ** 0.5
    return replace(
        base,
        n_envs=1,
        updates_per_step=1,
        exploration=(middle, middle),
        random_transitions=min(RANDOM_TRANSITIONS_ALONE, base.random_transitions),
    )


@dataclass(frozen=True)
class Median:
    """The median over seeds; None where half of the trainings or more never got there, which took longer than that."""

    value: float | None
    longer_than: float | None = None


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
            self.runs |= taking_turns(missing)
            if self._path is not None:
                runs = {name: [asdict(entry) for entry in entries] for name, entries in self.runs.items()}
                self._path.write_text(json.dumps({"settings": self._settings, "runs": runs}), encoding="utf-8")
        return [entry for name in trainings for entry in self.runs[name]]


def benchmark_train(
    *,
    setup: str = "open_field",
    seeds: int = 1,
    arms: Sequence[str] = ARMS,
    config: TrainBenchmarkConfig | None = None,
    base: BaseConfig | None = None,
    keep: Path | None = None,
) -> dict[str, Any]:
    """Processor seconds of training until a base policy reaches 94 %, ours (`fast`) against SB3 on the same fast engine
    and on PyBullet. One thread each, ours and SB3 on the fast engine in turns of some hundred updates, so that both
    share the machine with the same others; checks not counted. Processor seconds are wall-clock seconds on an idle
    machine; on a busy one nobody is charged for others' work, but for what they leave of caches and clock rate;
    `per_seed` holds both clocks, `load_average` how busy it was. `openblas_coretype`: which kernels NumPy's library was
    set to use (null: its own choice), which decides more than anything else; `torch_cpu_capability` likewise.

    Ours is judged by its last and its averaged weights, whichever are confirmed first, since base training considers
    both; SB3 by its last, since it does not average. `seconds_to_94` and `held_out_success` are medians of the first
    arm named (null if half of the trainings never got there). A ratio whose slow side is null has a lower bound
    beside it, `..._at_least`: its trainings that never got there count with the seconds they had spent.
    The PyBullet arm is SB3 as its users begin (one environment, one update per step), trained on the fast engine and
    charged with measured seconds per PyBullet step instead of the fast engine's; `sb3_pybullet_note` says so.
    keep: file that finished trainings are kept in; a broken run goes on from there.
    """
    unknown = [arm for arm in arms if arm not in ARMS]
    if unknown or not arms or seeds < 1:
        raise LearningError(f"arms = {list(arms)}, seeds = {seeds}: known arms are {', '.join(ARMS)}; at least 1 seed")
    config = config or TrainBenchmarkConfig()
    chosen = base or BaseConfig(setup=setup)
    if chosen.setup != setup:
        raise LearningError(f"base.setup = {chosen.setup!r} but setup = {setup!r}")
    kept = _Kept(keep, {"base": json.loads(json.dumps(chosen.as_dict())), "config": asdict(config)})
    trainings: dict[str, tuple[Train, BaseConfig]] = {
        "fast": (train_ours, chosen),
        "sb3_fast": (train_sb3, chosen),
        "sb3_pybullet": (train_sb3, alone(chosen)),
    }

    def train(seed: int, together: Mapping[str, tuple[Train, BaseConfig]]) -> list[Reached]:
        return kept.run(
            {f"{arm} {seed}": partial(how, arm, replace(of, seed=seed), config) for arm, (how, of) in together.items()}
        )

    load = [round(value, 2) for value in os.getloadavg()]
    groups = [[arm for arm in arms if (arm in IN_TURNS) == turns] for turns in (True, False)]
    trained = [e for seed in range(seeds) for names in groups for e in train(seed, {n: trainings[n] for n in names})]
    entries, note = trained, None
    if "sb3_pybullet" in arms:
        per_step = pybullet_seconds_per_step(get_setup(setup), config.pybullet_steps)
        entries = [_on_pybullet(entry, per_step) if entry.arm == "sb3_pybullet" else entry for entry in trained]
        note = (
            "not trained in PyBullet: SB3 with one environment and one update per step on the fast engine; its seconds "
            f"are its steps times {per_step * 1e3:.2f} ms per step of one PyBullet environment with wheel motors "
            f"(measured over {config.pybullet_steps} steps, restarts included) plus its seconds of updates"
        )
    judged = {arm: _judged(entries, arm, WEIGHTS[arm]) for arm in arms}
    medians = {arm: _median_seconds(found) for arm, found in judged.items()}
    return {
        "setup": setup,
        "seeds": seeds,
        "seconds_are": "processor time",
        "seconds_to_94": medians[arms[0]].value,
        "held_out_success": _median([e.held_out_success for e in judged[arms[0]]]),
        "seconds_to_94_per_arm": {arm: median.value for arm, median in medians.items()},
        "never_reached": {arm: sum(e.seconds_to_94 is None for e in found) for arm, found in judged.items()},
        "judged_by_weights": {arm: WEIGHTS[arm] for arm in arms},
        "per_seed": [asdict(entry) for entry in entries],
        **_ratios(medians, "sb3_fast"),
        **_ratios(medians, "sb3_pybullet"),
        "sb3_pybullet_note": note,
        "network_heads": list(chosen.heads),
        "openblas_coretype": os.environ.get("OPENBLAS_CORETYPE"),
        "torch_cpu_capability": torch.backends.cpu.get_cpu_capability(),
        "load_average": {"before": load, "after": [round(value, 2) for value in os.getloadavg()]},
        "scenes": {"check": config.check_scenes, "confirm": CONFIRM_SCENES, "confirm_scenes_are": "new at every try"},
        "gives_up_after": {"updates": config.max_updates, "seconds": config.max_seconds},
    }


def _on_pybullet(entry: Reached, seconds_per_step: float) -> Reached:
    """A training as if its steps had been PyBullet's; no wall clock saw that."""
    seconds = entry.transitions * seconds_per_step + entry.updates * entry.ms_per_update / 1e3
    return replace(
        entry,
        seconds=seconds,
        seconds_to_94=None if entry.seconds_to_94 is None else seconds,
        wall_seconds=None,
        ms_per_transition=seconds_per_step * 1e3,
    )


def _judged(entries: Sequence[Reached], arm: str, weights: Sequence[str]) -> list[Reached]:
    """One entry per seed: the weights that were confirmed first, or those that were trained longest without that."""
    found = [e for e in entries if e.arm == arm and e.weights in weights]
    per_seed = {e.seed: [other for other in found if other.seed == e.seed] for e in found}
    return [min(same, key=lambda e: (e.seconds_to_94 is None, e.seconds)) for same in per_seed.values()]


def _median_seconds(found: Sequence[Reached]) -> Median:
    value = _median([e.seconds_to_94 for e in found])
    return Median(value, None if value is not None else statistics.median(e.seconds for e in found))


def _ratios(medians: dict[str, Median], arm: str) -> dict[str, float | None]:
    """How many times as long `arm` takes as ours; a lower bound where it takes longer than anybody waited."""
    slow, fast = medians.get(arm, Median(None)), medians.get("fast", Median(None))
    return {
        f"ratio_vs_{arm}": _ratio(slow.value, fast.value),
        f"ratio_vs_{arm}_at_least": _ratio(slow.longer_than, fast.value),
    }


def _median(values: Sequence[float | None]) -> float | None:
    """The median, where a training that never got there counts as infinitely long."""
    middle = statistics.median(float("inf") if value is None else value for value in values)
    return None if middle == float("inf") else middle


def _ratio(slow: float | None, fast: float | None) -> float | None:
    return None if slow is None or fast is None else slow / fast
