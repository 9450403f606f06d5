"""The kinds of job and what each may be asked: typed parameters whose defaults say where they come from.

Light on purpose, because the analysts' forms are made from it; what a kind does lives in `runners.py` and below.
Labels and hints live in `locales/*/analyst.yaml` under `kinds.KIND.fields.NAME`, sources under `sources.KEY`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticUndefined

SetupName = Literal["study_room", "open_field"]
# backend/learning/scene_sets.py: a set has so many scenes, and a purpose more sets than anybody will count
MOST_SCENES = 10_000
LARGEST_SEED = 9_999


class JobParamsError(ValueError):
    """Parameters that a kind of job cannot run with; one entry per field."""

    def __init__(self, kind: str, problems: list[dict[str, Any]]) -> None:
        self.kind, self.problems = kind, problems
        told = "; ".join(f"{p['field']} = {p['value']!r}: {p['message']}" for p in problems)
        super().__init__(f"job kind {kind!r}: {told}")


class Params(BaseModel):
    """Base of all parameters: nothing unknown, nothing changed later."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    RENAMED: ClassVar[Mapping[str, str]] = {}
    """Old name -> name, of parameters in stored job rows and on old command lines: read, never written."""

    @model_validator(mode="before")
    @classmethod
    def _take_old_names(cls, given: Any) -> Any:
        return with_new_names(given, cls.RENAMED) if isinstance(given, dict) else given


def with_new_names(given: Mapping[str, Any], renamed: Mapping[str, str]) -> dict[str, Any]:
    """`given` with its old names replaced; an old name beside its new one stays, and is refused as unknown."""
    return {
        renamed[name] if name in renamed and renamed[name] not in given else name: value
        for name, value in given.items()
    }


def _from(source: str, default: Any = PydanticUndefined, *, advanced: bool = False, **limits: Any) -> Any:
    """A parameter with its default's source; `advanced` ones are folded away on the form."""
    return Field(default, json_schema_extra={"source": source, "advanced": advanced}, **limits)


def _artefact(kind: str, default: Any = PydanticUndefined) -> Any:
    """A parameter that names an artefact: its id, or the name of a shipped one such as `study_room/base`."""
    return Field(default, min_length=1, json_schema_extra={"source": "yours", "artefact": kind})


ModelName = Literal["linear", "weights", "mlp", "auto", "interface"]


class EvaluateParams(Params):
    """Measure one policy on fresh scenes."""

    policy: str = _artefact("policy")
    scenes: int = _from("ours", 2_000, ge=20, le=MOST_SCENES)
    seed: int = _from("ours_report_scenes", 0, ge=0, le=LARGEST_SEED)


class CompareParams(Params):
    """Measure two policies on the same fresh scenes."""

    policy_a: str = _artefact("policy")
    policy_b: str = _artefact("policy")
    scenes: int = _from("ours", 1_000, ge=20, le=MOST_SCENES)
    seed: int = _from("ours_report_scenes", 0, ge=0, le=LARGEST_SEED)
    replays: int = _from("ours", 12, ge=0, le=50, advanced=True)


class RewardModelParams(Params):
    """Learn what the answers of a snapshot say about driving; measure it on answers it did not see."""

    snapshot: str = _artefact("snapshot")
    model: ModelName = _from("spec_06_linear", "linear")
    reduction: Literal["sum", "mean"] = _from("thesis_6_4_4", "sum")
    folds: int = _from("ours", 5, ge=2, le=50, advanced=True)
    seed: int = _from("ours", 0, ge=0, le=LARGEST_SEED, advanced=True)


class AlignParams(Params):
    """Turn the answers of a snapshot into a policy, and check that it may be shown."""

    snapshot: str = _artefact("snapshot")
    setup: SetupName | None = _from("from_snapshot", None, advanced=True)
    base: str | None = Field(None, json_schema_extra={"source": "from_setup", "artefact": "policy", "advanced": True})
    recipe: Literal["instant", "refine", "thesis"] = _from("spec_06_recipe_b", "refine")
    start: Literal["base", "conditioned"] = _from("spec_06_recipe_b", "base", advanced=True)
    conditioned: str | None = Field(
        None, json_schema_extra={"source": "from_setup", "artefact": "conditioned_policy", "advanced": True}
    )
    model: ModelName | None = _from("from_recipe_model", None, advanced=True)
    symmetry: Literal["none", "left_right"] = _from("ours_symmetry", "none", advanced=True)
    reward_weight: float | None = _from("from_recipe_weight", None, gt=0, le=10)
    updates: int | None = _from("from_recipe_updates", None, ge=1, le=200_000)
    seed: int = _from("ours", 0, ge=0, le=LARGEST_SEED)
    gate_scenes: int = _from("ours", 500, ge=50, le=5_000, advanced=True)
    gate_least_success: float = _from("ours_gate", 0.90, ge=0, le=1, advanced=True)
    gate_most_loss: float = _from("issue_gate", 0.05, ge=0, le=1, advanced=True)
    comparisons: int = _from("spec_07_comparisons", 3, ge=0, le=10, advanced=True)
    hold_out: int = _from("ours", 0, ge=0, le=10, advanced=True)
    other: str | None = Field(
        None, min_length=1, json_schema_extra={"source": "yours", "artefact": "policy", "advanced": True}
    )


class TrainBaseParams(Params):
    """Train a policy from scratch on a setup's task reward."""

    RENAMED: ClassVar[Mapping[str, str]] = {"calm_weight": "smoothness_penalty"}

    setup: SetupName = _from("ours", "study_room")
    seed: int = _from("ours", 0, ge=0, le=LARGEST_SEED)
    updates: int = _from("ours_two_minutes", 60_000, ge=100, le=2_000_000)
    n_envs: int = _from("design_speed", 256, ge=1, le=4_096, advanced=True)
    updates_per_step: int = _from("design_speed", 12, ge=1, le=256, advanced=True)
    progress_weight: float = _from("spec_06_progress", 1.0, ge=0, le=10)
    smoothness_penalty: float = _from("ours_smoothness", 0.2, ge=0, le=10)
    learning_rate: float = _from("design_speed", 5e-4, gt=0, le=0.1, advanced=True)
    batch_size: int = _from("design_speed", 128, ge=8, le=4_096, advanced=True)
    selection_scenes: int = _from("ours", 2_000, ge=50, le=MOST_SCENES, advanced=True)


class EnsembleParams(Params):
    """Train members that start from one base policy and are pushed apart."""

    base: str = _artefact("policy", "study_room/base")
    members: int = _from("table_6_1", 4, ge=2, le=8)
    kappa: float = _from("table_6_1", 0.0625, ge=0, le=10)
    steps: int = _from("thesis_6_4_1", 25_000, ge=50, le=1_000_000)
    seed: int = _from("ours", 0, ge=0, le=LARGEST_SEED)


class QueriesParams(Params):
    """Make queries from the trajectories of an ensemble, without the trajectories that nobody could judge."""

    members: tuple[str, ...] = Field(
        tuple(f"study_room/ensemble/{k}" for k in range(4)),
        min_length=2,
        max_length=8,
        json_schema_extra={"source": "shipped", "artefact": "policy"},
    )
    count: int = _from("issue_queries", 200, ge=1, le=2_000)
    seed: int = _from("ours", 0, ge=0, le=LARGEST_SEED)
    max_duration_s: float = _from("ours_people_watch", 12.0, gt=2, le=100)
    min_gap_m: float = _from("ours_visible", 0.5, ge=0, le=10, advanced=True)


class TrainDemonstrationsParams(Params):
    """Learn a personal controller from a snapshot of demonstrations of one environment."""

    snapshot: str = _artefact("demonstrations")
    seed: int = _from("ours", 0, ge=0, le=LARGEST_SEED)
    updates: int = _from("ours_demonstrations", 40_000, ge=16, le=2_000_000)
    comparisons: int = _from("spec_02_pairs", 4, ge=0, le=4, advanced=True)
    gate_least_success: float = _from("issue_demonstrated_starts", 0.95, ge=0, le=1, advanced=True)


@dataclass(frozen=True)
class Kind:
    """One kind of job."""

    name: str
    params: type[Params]

    def parse(self, given: dict[str, Any]) -> Params:
        """Check parameters. Raises JobParamsError naming every field that is wrong and what would work."""
        try:
            return self.params.model_validate(given)
        except ValidationError as wrong:
            raise JobParamsError(
                self.name,
                [
                    {
                        "field": ".".join(str(part) for part in error["loc"]) or "params",
                        "value": None if error["type"] == "missing" else error["input"],
                        "message": error["msg"],
                        "type": error["type"],
                        "limits": {k: v for k, v in error.get("ctx", {}).items() if isinstance(v, int | float | str)},
                    }
                    for error in wrong.errors(include_url=False)
                ],
            ) from None


KINDS = {
    kind.name: kind
    for kind in (
        Kind("align", AlignParams),
        Kind("reward_model", RewardModelParams),
        Kind("compare", CompareParams),
        Kind("evaluate", EvaluateParams),
        Kind("train_base", TrainBaseParams),
        Kind("ensemble", EnsembleParams),
        Kind("queries", QueriesParams),
        Kind("train_demonstrations", TrainDemonstrationsParams),
    )
}


def get_kind(name: str) -> Kind:
    """The kind of that name. Raises JobParamsError listing the known ones."""
    try:
        return KINDS[name]
    except KeyError:
        problem = {"field": "kind", "value": name, "message": f"unknown; known: {', '.join(KINDS)}"}
        raise JobParamsError(name, [problem]) from None
