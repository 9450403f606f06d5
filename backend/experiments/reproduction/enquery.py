"""Chapter 6 as pieces of work: which there are for a budget, and what each computes.

The numbers made of them live in `enquery_results.py`, figures and report in `enquery_figures.py`, `enquery_report.py`.
Everything is simulated: the one who answers is the thesis's oracle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from backend.analysis.metrics import action_diversity
from backend.experiments.reproduction import thesis
from backend.experiments.reproduction.tasks import Function, Made, Piece
from backend.learning.alignment.align import AlignConfig, align, thesis_config
from backend.learning.alignment.conditioning_search import ConditioningSearchConfig, search_conditioning
from backend.learning.policies.evaluate import episodes
from backend.learning.policies.policy import Policy
from backend.learning.policies.shape import FAST_HEADS, THESIS_HEADS
from backend.learning.policies.shipped import load_conditioned, load_ensemble, load_policy, shipped_names
from backend.learning.preferences.oracles import make_oracle
from backend.learning.preferences.preferences import Preference
from backend.learning.queries.queries import Query, QueryConfig, generate_queries, segment_queries
from backend.learning.rewards.reward_mlp import MlpConfig, fit_mlp
from backend.learning.rewards.reward_model import RewardModel, accuracy, fit_linear
from backend.learning.rewards.reward_weights import fit_weights
from backend.learning.scene_sets import Purpose, scene_set
from backend.learning.td3.base import BaseConfig, train_base
from backend.learning.td3.ensemble import EnsembleConfig, train_ensemble
from backend.learning.td3.replay import collect
from backend.simulation.scene import Scene
from backend.simulation.trajectory import Outcome

SETUP = "open_field"
CONDITIONED = f"{SETUP}/conditioned"
ORACLE = "min-human-distance"  # 6.4.2
Source = Literal["EnQ", "BL"]
SOURCES: tuple[Source, ...] = ("EnQ", "BL")
CONDITIONS: dict[str, tuple[Source, int]] = {
    "EnQ-15": ("EnQ", 15),
    "EnQ-60": ("EnQ", 60),
    "BL-15": ("BL", 15),
    "BL-60": ("BL", 60),
}
MODELS = {"mlp": "neural", "linear": "linear", "weights": "weights"}  # the thesis's, then ours
TEST_SETS = ("ensemble pairs", "segments")

RECIPES = {
    "thesis": "the thesis's recipe",
    "refine": "our recipe from RAW",
    "instant": "our conditioned policy at once",
    "refined": "our conditioned policy, refined",
}
FROM_CONDITIONED = ("instant", "refined")

FIRST_SEED = 20_000  # of query and reporting scenes: beyond those of cards, benchmarks and studies
SEEDS_PER_RUN = 100
TEST_SEED = 99  # of the hundred seeds of a run


@dataclass(frozen=True)
class Budget:
    """How much is computed. `full` is the thesis's own amount, where the text gives one."""

    name: str
    heads: tuple[int, int]  # of base, ensemble, reward models and alignments; the sweep starts from the shipped base
    train: bool  # base and ensemble of these heads; False: the shipped ones
    kappas: tuple[float, ...]
    marks: tuple[int, ...]  # training steps at which the sweep looks
    sweep_scenes: int
    answers: tuple[int, ...]  # numbers of answers of the learning curve
    repetitions: int
    test_pairs: int
    alignments: int
    rollouts: int
    thesis_updates: int  # per epoch
    thesis_epochs: int
    refine_updates: int
    refine_checkpoints: int
    refined_tried: int = ConditioningSearchConfig.tried  # what else to tell the conditioned policy, in its refinement
    states: int = 1_000  # 6.5.1.1: in which action diversity is measured
    base_updates: int = BaseConfig(SETUP).updates
    ensemble_steps: int = thesis.ENSEMBLE_STEPS
    base_transitions: int = EnsembleConfig().base_transitions
    selection_scenes: int = AlignConfig().selection_scenes
    gate_scenes: int = AlignConfig().gate_scenes
    replay_transitions: int = AlignConfig().replay_transitions
    starts: int = 6  # per scene with trajectories drawn in it
    recipes: tuple[str, ...] = tuple(RECIPES)  # those from the conditioned policy only where one is shipped
    flow_fields: tuple[str, ...] = ("EnQ-15",)  # conditions by the thesis's recipe, against RAW; by ours only EnQ-15


SMALL = Budget(
    name="small",
    heads=FAST_HEADS,
    train=False,
    kappas=(0.0, thesis.KAPPA, 0.125),
    marks=(500, 1_000, 2_000),
    sweep_scenes=100,
    answers=(1, 2, 5, 10, 15, 20, 30, 60),
    repetitions=3,
    test_pairs=150,
    alignments=3,
    rollouts=100,
    thesis_updates=1_000,
    thesis_epochs=2,
    refine_updates=1_500,
    refine_checkpoints=3,
    refined_tried=32,
)
MEDIUM = replace(
    SMALL,
    name="medium",  # the thesis's amounts with our smaller heads, our refinement of the conditioned policy short
    kappas=(0.0, 0.03125, thesis.KAPPA, 0.125),
    marks=(5_000, 10_000, 15_000, 20_000, 25_000),
    sweep_scenes=500,
    answers=(1, 2, 4, 6, 8, 10, 15, 20, 30, 40, 60),
    repetitions=10,
    test_pairs=200,
    alignments=10,
    thesis_updates=10_000,
    thesis_epochs=3,
    refine_updates=AlignConfig().updates,
    refine_checkpoints=AlignConfig().checkpoints,
    flow_fields=tuple(CONDITIONS),
)
FULL = Budget(
    name="full",
    heads=THESIS_HEADS,
    train=True,
    kappas=(0.0, 0.015625, 0.03125, 0.046875, thesis.KAPPA, 0.078125, 0.09375, 0.125),
    marks=(5_000, 10_000, 15_000, 20_000, 25_000),
    sweep_scenes=500,
    answers=(1, 2, 4, 6, 8, 10, 12, 15, 18, 21, 25, 30, 36, 42, 50, 60),
    repetitions=10,
    test_pairs=200,
    alignments=10,
    rollouts=100,
    thesis_updates=10_000,
    thesis_epochs=3,
    refine_updates=AlignConfig().updates,
    refine_checkpoints=AlignConfig().checkpoints,
    flow_fields=tuple(CONDITIONS),
)
BUDGETS = {budget.name: budget for budget in (SMALL, MEDIUM, FULL)}


@dataclass(frozen=True)
class Speed:
    """Seconds of one TD3 update on this machine, by heads, for the estimate."""

    per_update: dict[tuple[int, int], float]


@dataclass(frozen=True)
class Plan:
    """All pieces of one reproduction, by what they are for. alignments: (recipe, condition) -> one piece per run."""

    budget: Budget
    seed: int
    base: Piece
    ensemble: Piece
    sweep: dict[float, Piece]
    accuracies: list[Piece]
    raw: Piece
    alignments: dict[tuple[str, str], list[Piece]]

    @property
    def recipes(self) -> dict[str, str]:
        """The recipes that are compared, with what they are called."""
        return {recipe: RECIPES[recipe] for recipe in dict.fromkeys(recipe for recipe, _ in self.alignments)}

    def pieces(self) -> list[Piece]:
        runs = [piece for pieces in self.alignments.values() for piece in pieces]
        return [self.base, self.ensemble, *self.sweep.values(), self.raw, *self.accuracies, *runs]


def query_seed(seed: int, run: int) -> int:
    """Seed of the queries of one repetition or alignment; both conditions of a source share them, 15 being the first
    of 60."""
    return FIRST_SEED + SEEDS_PER_RUN * seed + run


def align_config(recipe: str, budget: Budget, run: int) -> AlignConfig:
    """The configuration of one alignment: the thesis's recipe or ours, with the budget's number of updates."""
    if recipe == "thesis":
        config = replace(
            thesis_config(seed=run, epochs=budget.thesis_epochs), updates=budget.thesis_updates * budget.thesis_epochs
        )
    else:
        config = AlignConfig(seed=run, updates=budget.refine_updates, checkpoints=budget.refine_checkpoints)
    return replace(
        config,
        selection_scenes=budget.selection_scenes,
        gate_scenes=budget.gate_scenes,
        replay_transitions=budget.replay_transitions,
    )


def refined_config(budget: Budget, run: int) -> ConditioningSearchConfig:
    """The configuration of one refinement of the conditioned policy, as long as the budget says."""
    usual = ConditioningSearchConfig(seed=run, tried=budget.refined_tried)
    return replace(usual, selection_scenes=min(budget.selection_scenes, usual.selection_scenes))


def make_plan(budget: Budget, seed: int, speed: Speed) -> Plan:
    """The pieces of work. Raises ValueError for a seed without scenes of its own."""
    if not 0 <= seed < SEEDS_PER_RUN:
        raise ValueError(f"seed = {seed}: between 0 and {SEEDS_PER_RUN - 1}")
    fast, own = speed.per_update[FAST_HEADS], speed.per_update[budget.heads]
    shipped = _shipped("base", f"{SETUP}/base", [load_policy(f"{SETUP}/base")])
    base, ensemble = shipped, _shipped("ensemble", f"{SETUP}/ensemble", load_ensemble(SETUP))
    if budget.train:
        config = BaseConfig(SETUP, seed=seed, heads=budget.heads, updates=budget.base_updates)
        base = Piece("train_base", config.as_dict(), seconds=60 + own * config.updates)
        members = EnsembleConfig(seed=seed, steps=budget.ensemble_steps, base_transitions=budget.base_transitions)
        ensemble = Piece("train_ensemble", members.as_dict(), (base,), seconds=10 + own * 4 * members.steps)
    sweep = {
        kappa: Piece(
            "sweep",
            {
                "config": EnsembleConfig(
                    seed=seed, kappa=kappa, steps=max(budget.marks), base_transitions=budget.base_transitions
                ).as_dict(),
                "marks": list(budget.marks),
                "states": budget.states,
                "scenes": {"seed": FIRST_SEED + seed, "n": budget.sweep_scenes},
            },
            (shipped,),
            seconds=2 + fast * 4 * max(budget.marks) + 0.01 * len(budget.marks) * budget.sweep_scenes,
        )
        for kappa in budget.kappas
    }
    accuracies = [
        Piece(
            "accuracy",
            {
                "query_seed": query_seed(seed, run),
                "test_seed": query_seed(seed, TEST_SEED),
                "test_pairs": budget.test_pairs,
                "answers": list(budget.answers),
                "heads": list(budget.heads),
                "seed": run,
            },
            (base, ensemble),
            seconds=4 + len(budget.answers) * own / fast,
        )
        for run in range(budget.repetitions)
    ]
    alignments = {
        (recipe, condition): [
            _alignment(recipe, source, queries, run, budget, seed, own, (base, ensemble))
            for run in range(budget.alignments)
        ]
        for recipe in budget.recipes
        for condition, (source, queries) in CONDITIONS.items()
        if recipe not in FROM_CONDITIONED or CONDITIONED in shipped_names()
    }
    scenes = {"seed": FIRST_SEED + seed, "n": budget.rollouts}
    raw = Piece("raw", {"scenes": scenes}, (base,), seconds=1)
    return Plan(budget, seed, base, ensemble, sweep, accuracies, raw, alignments)


def _alignment(
    recipe: str,
    source: Source,
    queries: int,
    run: int,
    budget: Budget,
    seed: int,
    seconds_per_update: float,
    policies: tuple[Piece, Piece],
) -> Piece:
    asked = {"source": source, "queries": queries, "query_seed": query_seed(seed, run)}
    scenes = {"seed": FIRST_SEED + seed, "n": budget.rollouts}
    if recipe in FROM_CONDITIONED:
        params = asked | {
            "conditioned": CONDITIONED,
            "sha256": load_conditioned(CONDITIONED).digest(),
            "scenes": scenes,
        }
        if recipe == "instant":
            return Piece("instant", params, policies, seconds=3)
        refining = refined_config(budget, run)
        seconds = 6 + 0.0003 * refining.tried * refining.selection_scenes
        return Piece("refined", params | {"config": refining.as_dict()}, policies, seconds=seconds)
    config = align_config(recipe, budget, run)
    return Piece(
        "alignment",
        asked | {"heads": list(budget.heads), "config": config.as_dict(), "scenes": scenes},
        policies,
        seconds=4 + 0.8 * config.checkpoints + seconds_per_update * config.updates,
    )


def _shipped(kind: str, name: str, policies: Sequence[Policy]) -> Piece:
    return Piece(f"shipped_{kind}", {"name": name, "sha256": [policy.digest() for policy in policies]}, seconds=1)


def table_scenes(chosen: dict[str, int]) -> list[Scene]:
    """The scenes that a table's trajectories run in, the same for every policy."""
    return scene_set(SETUP, chosen["n"], purpose=Purpose.REPORT, seed=chosen["seed"])


# What each piece computes --------------------------------------------------------------------------------------------


def stored_policies(made: Made) -> list[Policy]:
    """The policies in a piece's result, in order."""
    return [Policy.from_bytes(made.arrays[name].tobytes()) for name in sorted(made.arrays) if "policy" in name]


def _with_policies(policies: Sequence[Policy], meta: dict[str, Any], **arrays: NDArray[Any]) -> Made:
    stored = {f"policy_{k}": np.frombuffer(p.to_bytes(), dtype=np.uint8) for k, p in enumerate(policies)}
    return Made(meta, {**arrays, **stored})


def take_shipped_base(params: dict[str, Any], needs: Sequence[Made]) -> Made:
    return _with_policies([load_policy(params["name"])], {})


def take_shipped_ensemble(params: dict[str, Any], needs: Sequence[Made]) -> Made:
    return _with_policies(load_ensemble(SETUP), {})


def train_base_piece(params: dict[str, Any], needs: Sequence[Made]) -> Made:
    result = train_base(BaseConfig(**_tuples(params)))
    return _with_policies([result.policy], {"selection_success_rate": result.selection_success})


def train_ensemble_piece(params: dict[str, Any], needs: Sequence[Made]) -> Made:
    base = stored_policies(needs[0])[0]
    result = train_ensemble(base, EnsembleConfig(**_tuples(params)), threads=1)  # pieces are made side by side
    return _with_policies(result.members, {"success_rates": result.success_rates, "diversity": result.diversity})


def sweep_piece(params: dict[str, Any], needs: Sequence[Made]) -> Made:
    """Success and action diversity of an ensemble at some numbers of steps (figure 6.2), its last weights each time.

    success_rates: (marks, members). diversity: (marks,), over states of the regenerated base buffer.
    """
    base, config = stored_policies(needs[0])[0], EnsembleConfig(**_tuples(params["config"]))
    chosen = params["scenes"]
    scenes = scene_set(SETUP, chosen["n"], purpose=Purpose.SELECT, seed=chosen["seed"])
    seen = np.asarray(collect(base, config.base_transitions, noise=config.exploration, seed=config.seed).filled()[0])
    states = seen[np.random.default_rng([config.seed, 62]).choice(len(seen), params["states"])]
    success: list[list[float]] = []
    diversity: list[float] = []

    def look(steps: int, members: list[Policy]) -> None:
        success.append([float((episodes(member, scenes).outcome == Outcome.SUCCESS).mean()) for member in members])
        diversity.append(action_diversity([member.act(states) for member in members]))

    train_ensemble(base, config, marks=params["marks"], on_members=look, threads=1)
    return Made({}, {"success_rates": np.array(success), "diversity": np.array(diversity)})


def ensemble_answers(members: Sequence[Policy], count: int, seed: int) -> list[Preference]:
    """The oracle's answers to pairs of ensemble trajectories, filtered as in the thesis and no further."""
    config = QueryConfig(
        count=count,
        seed=seed,
        max_duration_s=float("inf"),
        min_duration_s=0.0,
        min_gap_m=0.0,
        scenes_per_round=16 + count,  # changes no query, only how many scenes are driven beyond those needed
        max_scenes=256 + 4 * count,  # all are drawn before the first trajectory
    )
    return make_oracle(ORACLE).answer(generate_queries(members, config).queries)


def segment_answers(base: Policy, count: int, seed: int) -> list[Preference]:
    """The oracle's answers to the baseline's pairs of 20-step segments."""
    pairs = segment_queries(base, count, seed=seed)
    return make_oracle(ORACLE).answer([Query(a.scene, a, b, (0, 0)) for a, b in pairs])


def answers_of(source: Source, needs: Sequence[Made], count: int, seed: int) -> list[Preference]:
    """`needs`: base, ensemble."""
    if source == "BL":
        return segment_answers(stored_policies(needs[0])[0], count, seed)
    return ensemble_answers(stored_policies(needs[1]), count, seed)


def accuracy_piece(params: dict[str, Any], needs: Sequence[Made]) -> Made:
    """One repetition of figure 6.4: share of test pairs predicted, (models, sources, numbers of answers, test sets).

    Only the neural model can be fitted to one answer: NaN for the others.
    """
    tests = [
        answers_of("EnQ", needs, params["test_pairs"], params["test_seed"]),
        answers_of("BL", needs, params["test_pairs"], params["test_seed"]),
    ]
    values = np.full((len(MODELS), len(SOURCES), len(params["answers"]), len(tests)), np.nan)
    heads = (params["heads"][0], params["heads"][1])
    for s, source in enumerate(SOURCES):
        given = answers_of(source, needs, max(params["answers"]), params["query_seed"])
        for k, count in enumerate(params["answers"]):
            models: list[RewardModel] = [
                fit_mlp(given[:count], MlpConfig(seed=params["seed"], heads=heads, fewest_answers=1))
            ]
            if count > 1:
                models += [fit_linear(given[:count]), fit_weights(given[:count])]
            for m, model in enumerate(models):
                values[m, s, k] = [accuracy(model, test) for test in tests]
    return Made({}, {"accuracy": values})


def alignment_piece(params: dict[str, Any], needs: Sequence[Made]) -> Made:
    """One alignment and its trajectories in the table's scenes."""
    config = AlignConfig(**_tuples(params["config"]))
    given = answers_of(params["source"], needs, params["queries"], params["query_seed"])
    heads = (params["heads"][0], params["heads"][1])
    model: RewardModel = (
        fit_mlp(given, MlpConfig(seed=config.seed, heads=heads)) if config.recipe == "thesis" else fit_linear(given)
    )
    result = align(stored_policies(needs[0])[0], model, config)
    meta = {
        "chosen": result.chosen,
        "history": result.history,
        "gate_passed": result.gate.passed,
        "preference_weight": result.preference_weight,
        "replay_sha256": result.replay_sha256,
    }
    return _driven(result.policy, params["scenes"], meta)


def instant_piece(params: dict[str, Any], needs: Sequence[Made]) -> Made:
    """The conditioned policy at the weights that the answers say, and its trajectories in the table's scenes."""
    weights = weights_said(params, needs)
    policy = load_conditioned(params["conditioned"]).at(weights).without_critic()
    return _driven(policy, params["scenes"], {"weights": weights.tolist()})


def refined_piece(params: dict[str, Any], needs: Sequence[Made]) -> Made:
    """The same refined; trajectories are the conditioned policy's where the refinement was no improvement."""
    weights = weights_said(params, needs)
    conditioned = load_conditioned(params["conditioned"])
    base = stored_policies(needs[0])[0]
    result = search_conditioning(conditioned, weights, base, ConditioningSearchConfig(**params["config"]))
    shown = result.policy if result.takes_over else conditioned.at(weights).without_critic()
    meta = {
        "weights": weights.tolist(),
        "told": result.offsets.tolist(),
        "takes_over": result.takes_over,
        "wanted": result.wanted.as_dict(),
        "score": result.score.as_dict(),
        "gate_passed": result.gate.passed,
        "chosen": result.chosen,
        "history": result.history,
    }
    return _driven(shown, params["scenes"], meta)


def weights_said(params: dict[str, Any], needs: Sequence[Made]) -> NDArray[np.float32]:
    """What the answers of one run ask of the conditioned policy."""
    given = answers_of(params["source"], needs, params["queries"], params["query_seed"])
    return fit_weights(given).preference_weights()


def raw_piece(params: dict[str, Any], needs: Sequence[Made]) -> Made:
    """The base policy's trajectories in the table's scenes."""
    return _driven(stored_policies(needs[0])[0].without_critic(), params["scenes"], {})


def _driven(policy: Policy, scenes: dict[str, int], meta: dict[str, Any]) -> Made:
    table = episodes(policy, table_scenes(scenes))
    return _with_policies(
        [policy],
        meta,
        outcome=table.outcome,
        min_human_distance=table.min_human_distance,
        path_length=table.path_length,
        time=table.time,
        self_intersections=table.self_intersections,
        ceiling=table.ceiling,
    )


def _tuples(params: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(value) if isinstance(value, list) else value for name, value in params.items()}


FUNCTIONS: dict[str, Function] = {
    "shipped_base": take_shipped_base,
    "shipped_ensemble": take_shipped_ensemble,
    "train_base": train_base_piece,
    "train_ensemble": train_ensemble_piece,
    "sweep": sweep_piece,
    "accuracy": accuracy_piece,
    "raw": raw_piece,
    "alignment": alignment_piece,
    "instant": instant_piece,
    "refined": refined_piece,
}
