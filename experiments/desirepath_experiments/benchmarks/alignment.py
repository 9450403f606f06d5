"""How long it takes from the last answer to a policy that can be shown, and how far that policy moved.

Clocks live in this room of benchmarks, nowhere in learning.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import Field

from desirepath.learning.alignment.conditioning_search import ConditioningSearchConfig, search_conditioning
from desirepath.learning.alignment.fine_tuning import FineTuningConfig
from desirepath.learning.alignment.relabelling import RelabellingConfig, align
from desirepath.learning.alignment.thesis import ThesisConfig, thesis_config
from desirepath.learning.errors import LearningError
from desirepath.learning.policies.conditioned import settings
from desirepath.learning.policies.evaluate import compare_policies, evaluate_policy
from desirepath.learning.policies.networks import use_one_thread
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shipped import load_conditioned, load_ensemble, load_policy
from desirepath.learning.policies.steerability import steerability_of
from desirepath.learning.preferences.objectives import NAMES
from desirepath.learning.preferences.oracles import ORACLE_PREFERENCES, ResponseModel, make_oracle
from desirepath.learning.preferences.preferences import Preference
from desirepath.learning.preferences.setup_settings import longest_simulated_s
from desirepath.learning.queries.queries import QueryConfig, generate_queries
from desirepath.learning.rewards.linear import fit_linear
from desirepath.learning.rewards.mlp import MlpConfig, fit_mlp
from desirepath.learning.rewards.weights import fit_weights
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath_experiments.benchmarks.results import Progress

Floats = NDArray[np.float32]
Config = RelabellingConfig | ConditioningSearchConfig
FIRST_REPORT_SEED = 400  # reporting scenes that no card uses and nothing was chosen on
FIRST_QUERY_SEED = 1_000  # query scenes that no shipped set uses


@pydantic.dataclasses.dataclass(frozen=True)
class AlignConfig(ResponseModel):
    """Who answers how many queries, and what is made of the answers."""

    setup: Annotated[str, Field(description="study_room or open_field.")] = "open_field"
    mode: Annotated[
        Literal["instant", "conditioning_search", "fine_tuning", "thesis"], Field(description="How a policy is made.")
    ] = "conditioning_search"
    oracle: Annotated[str, Field(description="Who answers.")] = "min-human-distance"
    queries: Annotated[int, Field(ge=2, description="Fresh ones of the shipped ensemble.")] = 15
    seed: int = 0
    n: Annotated[int, Field(ge=2, description="Fresh scenes in which the policies are compared.")] = 2_000


@dataclass(frozen=True)
class AlignedPolicy:
    """What followed the last answer. more: further keys of the result. search: the instant policy and what became
    of it, whether that takes over or not.
    """

    policy: Policy
    more: dict[str, Any] = field(default_factory=dict)
    search: tuple[Policy, Policy] | None = None


def align_at_once(setup: str, preferences: list[Preference], config: Config) -> AlignedPolicy:
    """Recipe A: the posterior after all answers, its weights folded into the conditioned policy."""
    del config  # nothing is trained
    weights = fit_weights(preferences).preference_weights()
    return AlignedPolicy(
        load_conditioned(f"{setup}/conditioned").at(weights), {"preference_weights": name_weights(weights)}
    )


def search(setup: str, preferences: list[Preference], config: Config) -> AlignedPolicy:
    """Conditioning search from the instant policy on, which stays where that is not better on the gate's scenes."""
    if not isinstance(config, ConditioningSearchConfig):
        raise LearningError(f"config = {config}: mode conditioning_search needs a ConditioningSearchConfig")
    weights = fit_weights(preferences).preference_weights()
    conditioned = load_conditioned(f"{setup}/conditioned")
    result = search_conditioning(conditioned, weights, load_policy(f"{setup}/base"), config)
    more = {
        "preference_weights": name_weights(weights),
        "offsets": result.offsets.tolist(),
        "takes_over": result.takes_over,
        "preferred": result.preferred.as_dict(),
        "score": result.score.as_dict(),
        "gate": asdict(result.gate),
        "chosen": result.chosen,
    }
    instantly = conditioned.at(weights)
    return AlignedPolicy(result.policy if result.takes_over else instantly, more, (instantly, result.policy))


def from_base(setup: str, preferences: list[Preference], config: Config) -> AlignedPolicy:
    """Fine-tuning of the base policy with the nine-feature model, or the thesis's recipe with the neural one."""
    if not isinstance(config, RelabellingConfig):
        raise LearningError(f"config = {config}: modes fine_tuning and thesis need a RelabellingConfig")
    use_one_thread()
    neural = isinstance(config, ThesisConfig)
    model = fit_mlp(preferences, MlpConfig(seed=config.seed)) if neural else fit_linear(preferences)
    result = align(load_policy(f"{setup}/base"), model, config)
    more = {
        "gate": asdict(result.gate),
        "preference_weight": result.reward_weight,
        "chosen_checkpoint": result.chosen,
    }
    return AlignedPolicy(result.policy, more)


@dataclass(frozen=True)
class Mode:
    """make: answers to policy. own_process: whether it is started as a job would be, imports included."""

    make: Callable[[str, list[Preference], Config], AlignedPolicy]
    config: Callable[[int], Config]
    own_process: bool = True


MODES = {
    "instant": Mode(align_at_once, lambda seed: FineTuningConfig(seed=seed), own_process=False),
    "conditioning_search": Mode(search, lambda seed: ConditioningSearchConfig(seed=seed)),
    "fine_tuning": Mode(from_base, lambda seed: FineTuningConfig(seed=seed)),
    "thesis": Mode(from_base, lambda seed: thesis_config(seed=seed)),
}


def benchmark_align(
    config: AlignConfig, progress: Progress | None = None, *, training: Config | None = None
) -> dict[str, Any]:
    """From the last answer to a policy ready to show, and what it gained.

    `seconds` of mode instant: posterior from all answers, file, fold, in a process that runs already, as the server
    does; of the others: a process of its own with its imports, model, training and gate. Queries are fresh ones of the
    shipped ensemble. `base`, `neutral` (the conditioned policy at no weights) and `aligned` are as from
    `evaluate`; `paired_gain` is the ratio of mean minimum human distances (aligned / base) over the scenes in which
    both succeed, with its 95 % interval. `share_of_the_way` is of the oracle's foremost objective, from the base policy
    to what is possible (`movement.best_possible`); null for an oracle outside the vocabulary. `against_instant` (mode
    conditioning_search): what the search found compared with the instant policy, whether it takes over or not.
    """
    setup, oracle, n, mode = config.setup, config.oracle, config.n, MODES[config.mode]
    base, neutral = load_policy(f"{setup}/base"), load_conditioned(f"{setup}/conditioned").at(settings()["neutral"])
    query_config = QueryConfig(
        count=config.queries, seed=FIRST_QUERY_SEED + config.seed, max_duration_s=longest_simulated_s(setup)
    )
    queries = generate_queries(load_ensemble(setup), query_config)
    answering = make_oracle(
        oracle,
        lapse_rate=config.lapse_rate,
        seed=config.seed,
        indifference=config.indifference,
        myopia_s=config.myopia_s,
        peak_end=config.peak_end,
    )
    seconds, aligned_policy = _time(
        mode, setup, answering.answer(queries.queries), training or mode.config(config.seed)
    )
    report_seed = FIRST_REPORT_SEED + config.seed
    compared = compare_policies(base, aligned_policy.policy, n=n, seed=report_seed)
    objective = (*(ORACLE_PREFERENCES[oracle].objectives if oracle in ORACLE_PREFERENCES else ()), None)[0]
    aligned = evaluate_policy(aligned_policy.policy, n=n, seed=report_seed)
    return {
        "setup": setup,
        "mode": config.mode,
        "oracle": oracle,
        "noise": config.lapse_rate,
        "indifference": config.indifference,
        "myopia_s": config.myopia_s,
        "queries": config.queries,
        "seed": config.seed,
        "seconds": seconds,
        "base": evaluate_policy(base, n=n, seed=report_seed),
        "neutral": evaluate_policy(neutral, n=n, seed=report_seed),
        "aligned": aligned,
        "self_intersections_per_episode": aligned["self_intersections"],
        "paired_gain": compared["paired"]["min_human_distance_m"]["ratio"],
        "paired": compared["paired"],
        "success_difference": compared["success_difference"],
        "both_succeed": compared["both_succeed"],
        "ceiling_m": compared["ceiling_m"],
        "objective": objective,
        **_measure_movement(objective, base, neutral, aligned_policy.policy, n, report_seed),
        **aligned_policy.more,
        **(
            {"against_instant": compare_policies(*aligned_policy.search, n=n, seed=report_seed)}
            if aligned_policy.search
            else {}
        ),
    }


def _time(mode: Mode, setup: str, preferences: list[Preference], config: Config) -> tuple[float, AlignedPolicy]:
    if not mode.own_process:
        began = time.perf_counter()
        aligned = mode.make(setup, preferences, config)
        return time.perf_counter() - began, aligned
    began = time.perf_counter()
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        aligned = pool.submit(mode.make, setup, preferences, config).result()
    return time.perf_counter() - began, aligned


def _measure_movement(
    objective: str | None, base: Policy, neutral: Policy, aligned: Policy, n: int, seed: int
) -> dict[str, Any]:
    """`share_of_the_way` and, under `moved`, the objective's measure in detail."""
    if objective is None:
        return {"share_of_the_way": None, "moved": None}
    scenes = scene_set(base.setup, n, purpose=Purpose.REPORT, seed=seed)
    moved = steerability_of({objective: aligned, "neutral": neutral}, base, scenes).moved(objective)
    return {"share_of_the_way": moved["share_of_the_way"], "moved": moved}


def name_weights(weights: Floats) -> dict[str, float]:
    return {name: float(weight) for name, weight in zip(NAMES, weights, strict=True) if weight > 0}
