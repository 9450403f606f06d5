"""The kinds of job and what each may be asked: typed parameters whose defaults say where they come from.

Light on purpose, because the analysts' forms are made from it; what a kind does lives in `runners.py` and below.
Labels and hints live in `locales/*/analyst.yaml` under `kinds.KIND.fields.NAME`, sources under `sources.KEY`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from desirepath.jobs.alignment import DEFAULT, RECIPE, REGISTRY, AlignParams
from desirepath.jobs.params import (
    LARGEST_SEED,
    MOST_SCENES,
    ModelName,
    OwnSetup,
    Params,
    TrainedSetup,
    artefact,
    from_source,
)


class JobParamsError(ValueError):
    """Parameters that a kind of job cannot run with; one entry per field."""

    def __init__(self, kind: str, problems: list[dict[str, Any]]) -> None:
        self.kind, self.problems = kind, problems
        message = "; ".join(f"{p['field']} = {p['value']!r}: {p['message']}" for p in problems)
        super().__init__(f"job kind {kind!r}: {message}")


CONDITIONED, ADAPTABLE = "conditioned_policy", "adaptable_policy"
WEIGHED = (CONDITIONED, ADAPTABLE)
"""Kinds of policies that take weights: of the nine objectives, or of chapter 5's three."""
ANY_POLICY = "|".join(("policy", *WEIGHED, "attention_policy", "depth_controller"))
"""Kinds of artefact that drive."""


def _checked_weights(words: str) -> str:
    """Raises ValueError saying what no policy can be conditioned on."""
    from desirepath.learning.adaptable.objectives import NAMES
    from desirepath.learning.errors import OppositeWeights
    from desirepath.learning.policies.adaptable import parse_preference
    from desirepath.learning.preferences.objectives import parse_weights

    try:
        (parse_preference if words.partition("=")[0].strip() in NAMES else parse_weights)(words)
    except OppositeWeights as wrong:  # of a type of its own, so that forms say it in their language
        raise PydanticCustomError("opposites", "{message}", {"message": str(wrong)}) from None
    return words


Weights = Annotated[str, AfterValidator(_checked_weights)]
"""What a conditioned policy is conditioned on, `farther=1,smoother=0.5`, empty: nothing; or an adaptable one,
`distance=0.5,efficiency=0.5`, empty: a third of each."""


def _weights_of(policy: str) -> Any:
    """Preference weights of the policy that another parameter names, where that is a conditioned one."""
    return Field("", max_length=500, json_schema_extra={"source": "yours", "weights_of": policy})


class EvaluateParams(Params):
    """Measure one policy on fresh scenes."""

    policy: str = artefact(ANY_POLICY)
    scenes: int = from_source("ours", 2_000, ge=20, le=MOST_SCENES)
    seed: int = from_source("ours_report_scenes", 0, ge=0, le=LARGEST_SEED)


class CompareParams(Params):
    """Measure two policies on the same fresh scenes, conditioned ones at the weights that are given with them."""

    policy_a: str = artefact(ANY_POLICY)
    weights_a: Weights = _weights_of("policy_a")
    policy_b: str = artefact(ANY_POLICY)
    weights_b: Weights = _weights_of("policy_b")
    scenes: int = from_source("ours", 1_000, ge=20, le=MOST_SCENES)
    seed: int = from_source("ours_report_scenes", 0, ge=0, le=LARGEST_SEED)
    replays: int = from_source("ours", 12, ge=0, le=50, advanced=True)


class RewardModelParams(Params):
    """Learn what the answers of a snapshot say about driving; measure it on answers it did not see."""

    snapshot: str = artefact("snapshot")
    model: ModelName = from_source("ours_few_answers", "linear")
    reduction: Literal["sum", "mean"] = from_source("thesis_6_4_4", "sum")
    folds: int = from_source("ours", 5, ge=2, le=50, advanced=True)
    seed: int = from_source("ours", 0, ge=0, le=LARGEST_SEED, advanced=True)


ALIGNMENTS: Mapping[str, type[AlignParams]] = {
    name: REGISTRY[name].params for name in sorted(REGISTRY, key=lambda name: (name != DEFAULT, name))
}
"""By `recipe`; the first is the one that is meant where none is named."""
AnyAlignment: Any = Annotated[reduce(or_, ALIGNMENTS.values()), Field(discriminator="recipe")]


class TrainBaseParams(Params):
    """Train a policy from scratch on a setup's task reward."""

    setup: TrainedSetup = from_source("ours", "study_room")
    seed: int = from_source("ours", 0, ge=0, le=LARGEST_SEED)
    updates: int | None = from_source("ours_of_setup", None, ge=100, le=2_000_000)
    n_envs: int = from_source("design_speed", 256, ge=1, le=4_096, advanced=True)
    updates_per_step: int = from_source("design_speed", 12, ge=1, le=256, advanced=True)
    progress_weight: float = from_source("ours_progress", 1.0, ge=0, le=10)
    smoothness_penalty: float = from_source("ours_smoothness", 0.2, ge=0, le=10)
    learning_rate: float = from_source("design_speed", 5e-4, gt=0, le=0.1, advanced=True)
    batch_size: int = from_source("design_speed", 128, ge=8, le=4_096, advanced=True)
    selection_scenes: int = from_source("ours", 2_000, ge=50, le=MOST_SCENES, advanced=True)


class TrainSetupParams(Params):
    """Make everything that studies need in a lab's own setup: policies and query sets."""

    setup: OwnSetup = from_source("yours")
    seed: int = from_source("ours", 0, ge=0, le=LARGEST_SEED)
    queries: int = from_source("ours_different_queries", 200, ge=10, le=2_000)
    effort: float = from_source("ours", 1.0, ge=0.001, le=10, advanced=True)


class EnsembleParams(Params):
    """Train members that start from one base policy and are pushed apart."""

    base: str = artefact("policy", "study_room/base")
    members: int = from_source("table_6_1", 4, ge=2, le=8)
    kappa: float = from_source("table_6_1", 0.0625, ge=0, le=10)
    steps: int = from_source("thesis_6_4_1", 25_000, ge=50, le=1_000_000)
    seed: int = from_source("ours", 0, ge=0, le=LARGEST_SEED)


class QueriesParams(Params):
    """Make queries from the trajectories of an ensemble, without the trajectories that nobody could judge."""

    members: tuple[str, ...] = Field(
        tuple(f"study_room/ensemble/{k}" for k in range(4)),
        min_length=2,
        max_length=8,
        json_schema_extra={"source": "shipped", "artefact": "policy"},
    )
    count: int = from_source("ours_different_queries", 200, ge=1, le=2_000)
    seed: int = from_source("ours", 0, ge=0, le=LARGEST_SEED)
    max_duration_s: float = from_source("ours_people_watch", 12.0, gt=2, le=100)
    min_gap_m: float = from_source("ours_visible", 0.5, ge=0, le=10, advanced=True)


class TrainDemonstrationsParams(Params):
    """Learn a personal controller from a snapshot of demonstrations of one environment.

    sensor: what it goes by: `places` of person, walls and things (chapter 2), or its `depth` camera (chapter 3), which
    is for homes; None: what the environment was made for. imitated: updates before all others, of `places` alone; 0:
    as in the thesis, and where updates alone are given. updates: None: as many as that needs.
    """

    snapshot: str = artefact("demonstrations")
    sensor: Literal["places", "depth"] | None = from_source("from_environment", None)
    seed: int = from_source("ours", 0, ge=0, le=LARGEST_SEED)
    updates: int | None = from_source("ours_demonstrations", None, ge=16, le=2_000_000)
    imitated: int = from_source("ours_demonstrations", 4_800, ge=0, le=100_000, advanced=True)
    comparisons: int = from_source("thesis_2_6_1", 4, ge=0, le=4, advanced=True)
    gate_min_success: float = from_source("ours_demonstrated_starts", 0.95, ge=0, le=1, advanced=True)

    @model_validator(mode="before")
    @classmethod
    def _stored_before_imitation(cls, data: Any) -> Any:
        """Parameters of a job of before 2026-11-28 name updates alone: it goes on as it was asked for."""
        if isinstance(data, dict) and data.get("updates") is not None and "imitated" not in data:
            return data | {"imitated": 0}
        return data


class AskPersonParams(Params):
    """Ask a reward model as if it were a participant: how well, and how surely, its answers are predicted, and what its
    robot would gain.

    answers: the most that it gives; it is also measured after those of MEASURED_AFTER that are fewer.
    """

    reward: str = artefact("reward_model")
    answers: int = from_source("ours", 50, ge=8, le=200)
    response_model: Literal["right", "lapses", "indifference", "peak_end", "first_seconds"] = from_source(
        "ours", "right"
    )
    choose: Literal["information", "random"] = from_source("ours", "information", advanced=True)
    seed: int = from_source("ours", 0, ge=0, le=LARGEST_SEED, advanced=True)


class TaskParams(Params):
    """One task of a sweep (`desirepath reproduce CHAPTER --on workers`); that command alone starts it, no form has it.

    key: the hash of all that its result depends on; needs: keys of the tasks whose results it gets.
    """

    chapter: str
    key: str
    function: str
    params: dict[str, Any]
    needs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Kind:
    """One kind of job. variants: its parameters; where it has several algorithms, one class by each `recipe`."""

    name: str
    variants: Mapping[str, type[Params]]
    union: Any = None  # of the variants, discriminated by `recipe`

    @property
    def params(self) -> type[Params]:
        """The parameters, of several variants the first."""
        return next(iter(self.variants.values()))

    def model_for(self, given: Mapping[str, Any]) -> type[Params]:
        """The class of these parameters; of an unknown algorithm the first one's."""
        return self.variants.get(self.algorithm_of(given), self.params)

    def algorithm_of(self, given: Mapping[str, Any]) -> str:
        """The algorithm that these parameters name, or the one that is meant; empty where there is only one way."""
        return str(given.get(RECIPE, DEFAULT)) if self.union is not None else ""

    def parse(self, given: Mapping[str, Any]) -> Params:
        """Check parameters. Raises JobParamsError naming every field that is wrong and what would work."""
        try:
            if self.union is None:
                return self.params.model_validate(given)
            parsed: Params = TypeAdapter(self.union).validate_python({RECIPE: DEFAULT, **given})
        except ValidationError as wrong:
            raise JobParamsError(
                self.name, [self._problem(error) for error in wrong.errors(include_url=False)]
            ) from None
        return parsed

    def _in_words(self, error: Any) -> str:
        """What is wrong with one parameter, and what would work."""
        if error["type"] == "missing":
            return "has to be given"
        if error["type"] == "extra_forbidden":
            known = self.variants.get(str(error["loc"][0]), self.params).model_fields
            return f"is no parameter here; there are {', '.join(sorted(known))}"
        return str(error["msg"]).removeprefix("Value error, ").replace("Input should be", "must be")

    def _problem(self, error: Any) -> dict[str, Any]:
        if error["type"].startswith("union_tag"):
            known = ", ".join(repr(name) for name in self.variants)
            return {
                "field": RECIPE,
                "value": error["input"].get(RECIPE),
                "message": f"must be one of {known}",
                "type": "literal_error",
                "limits": {"expected": known},
            }
        where = [str(part) for part in error["loc"]]
        if self.union is not None:
            where = where[1:]  # the algorithm comes first
        return {
            "field": ".".join(where) or "params",
            "value": None if error["type"] == "missing" else error["input"],
            "message": self._in_words(error),
            "type": error["type"],
            "limits": {k: v for k, v in error.get("ctx", {}).items() if isinstance(v, int | float | str)},
        }


def _one(name: str, params: type[Params]) -> Kind:
    return Kind(name, {"": params})


KINDS = {
    kind.name: kind
    for kind in (
        Kind("align", ALIGNMENTS, AnyAlignment),
        _one("reward_model", RewardModelParams),
        _one("compare", CompareParams),
        _one("evaluate", EvaluateParams),
        _one("train_base", TrainBaseParams),
        _one("train_setup", TrainSetupParams),
        _one("ensemble", EnsembleParams),
        _one("queries", QueriesParams),
        _one("train_demonstrations", TrainDemonstrationsParams),
        _one("ask_person", AskPersonParams),
    )
}
TASK = "task"
OF_SWEEPS = _one(TASK, TaskParams)
"""A kind of job that nobody starts by hand."""


def named_artefacts(params: Params) -> list[tuple[str, str]]:
    """(reference, kind of artefact) of every artefact that a job's parameters name."""
    named = []
    for name, field in type(params).model_fields.items():
        extra = field.json_schema_extra
        wanted = extra.get("artefact") if isinstance(extra, dict) else None
        given = getattr(params, name)
        if isinstance(wanted, str) and given:
            named += [(str(reference), wanted) for reference in (given if isinstance(given, list | tuple) else [given])]
    return named


def get_kind(name: str) -> Kind:
    """The kind of that name. Raises JobParamsError listing the known ones."""
    if name == TASK:
        return OF_SWEEPS
    try:
        return KINDS[name]
    except KeyError:
        problem = {"field": "kind", "value": name, "message": f"unknown; known: {', '.join(KINDS)}"}
        raise JobParamsError(name, [problem]) from None
