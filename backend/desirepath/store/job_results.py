"""What each kind of job results in, as it is stored in its row: checked when it is kept, read by `Job.result_as`.

Measurements (gates, verdicts, predictions) are the science's own dictionaries, whose fields stand at their classes.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict


class JobResult(BaseModel):
    """Base of all. Nothing unknown, nothing changed later."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @property
    def made(self) -> list[str]:
        """Ids of the artefacts that the job made, the main one first."""
        return [artefact for artefact in (getattr(self, name, None) for name in MADE) if isinstance(artefact, str)]


MADE = ("policy", "reward_model", "evaluation", "query_set")


class Rollouts(JobResult):
    """Trajectories (ids) in one scene: the own policy's and what it is compared with. scene: hash."""

    scene: str | None = None
    scene_seed: int | None = None
    look_alike: bool = False
    own: str | None = None
    base: str | None = None
    other: str | None = None
    neutral: str | None = None
    population: str | None = None
    social_cost: str | None = None

    def of(self, who: str) -> str:
        """The trajectory of `own`, `base` or another of these. Raises KeyError where there is none."""
        trajectory = getattr(self, who)
        if not isinstance(trajectory, str):
            raise KeyError(f"rollouts in scene {self.scene} have none of {who!r}")
        return trajectory


class Learned(JobResult):
    """A policy of somebody's own. passed, why: may they be shown it (`learning.alignment.gate.decide`). comparisons:
    empty where not."""

    policy: str
    passed: bool
    why: Literal["passed", "gate_not_passed", "not_better_than_instant", "not_surely_better"] | None = None
    gate: dict[str, Any] = {}
    comparisons: list[Rollouts] = []
    seconds: float | None = None


class AlignResult(Learned):
    """yoked: comparisons with another participant's policy or a stand-in's; neutral: with the conditioned policy
    without preferences; population: with the one by what earlier participants want, in_general: how that was made
    (`PeopleInGeneral`). personal: `PersonalVerdict`; check: `PredictiveCheck`; prior: by the light of how many it was
    judged. free_form: not described by the nine objectives. Alignments may add measurements of their own."""

    model_config = ConfigDict(extra="allow", frozen=True)

    reward_model: str | None = None
    training_accuracy: float | None = None
    held_out: dict[str, Any] | None = None
    predicted: dict[str, Any] = {}
    personal: dict[str, Any] | None = None
    check: dict[str, Any] | None = None
    prior: dict[str, Any] | None = None
    yoked: list[Rollouts] = []
    neutral: list[Rollouts] = []
    population: list[Rollouts] = []
    in_general: dict[str, Any] | None = None
    free_form: bool = False


class PathRollout(JobResult):
    """The learned controller from the start of one demonstration (sha256) of a situation."""

    demonstration: str
    pair: int
    trajectory: str


class DemonstrationsResult(Learned):
    """judged: its rollouts against the demonstrations. situations: of three controllers, one per demonstrated pair."""

    judged: dict[str, float | None] = {}
    rollouts: list[PathRollout] = []
    situations: list[Rollouts] = []


class RewardModelResult(JobResult):
    reward_model: str
    training_accuracy: float
    answers: int
    held_out: list[dict[str, Any]]
    predicted: dict[str, Any]
    kind: str
    importance: dict[str, float] = {}


class EvaluateResult(JobResult):
    evaluation: str
    measured: dict[str, Any]


class CompareResult(JobResult):
    evaluation: str
    compared: dict[str, Any]


class TrainBaseResult(JobResult):
    policy: str
    selection_success: float
    transitions: int


class TrainSetupResult(JobResult):
    """success_rate: of the base policy. begun_anew: how often its training stood still."""

    success_rate: float
    begun_anew: int
    seconds: dict[str, float]
    policies: list[str]
    query_sets: list[str]

    @property
    def made(self) -> list[str]:
        return [*self.policies, *self.query_sets]


class EnsembleResult(JobResult):
    policies: list[str]
    success_rates: list[float]
    diversity: Any

    @property
    def made(self) -> list[str]:
        return self.policies


class QueriesResult(JobResult):
    query_set: str
    queries: int
    filtered: dict[str, Any]


class AskPersonResult(JobResult):
    """What `benchmark_people` measures, of one person."""

    model_config = ConfigDict(extra="allow", frozen=True)


RESULTS: dict[str, type[JobResult]] = {
    "align": AlignResult,
    "train_demonstrations": DemonstrationsResult,
    "reward_model": RewardModelResult,
    "evaluate": EvaluateResult,
    "compare": CompareResult,
    "train_base": TrainBaseResult,
    "train_setup": TrainSetupResult,
    "ensemble": EnsembleResult,
    "queries": QueriesResult,
    "ask_person": AskPersonResult,
}
"""By kind of job."""
