"""What `import desirepath` offers to a notebook: scenes, rollouts, queries, beliefs, policies, reports.

Thin on purpose: every name here calls the room that does the work. No database and no server are needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from desirepath.learning.errors import LearningError
from desirepath.learning.policies.evaluate import evaluate_policy
from desirepath.learning.policies.shipped import load_conditioned, load_policy, load_queries
from desirepath.learning.preferences import posterior as beliefs
from desirepath.learning.preferences.objectives import names_of
from desirepath.learning.preferences.spans import seen_in
from desirepath.learning.queries.choosing import Candidates
from desirepath.learning.queries.queries import QuerySet
from desirepath.learning.queries.strategies.information import Information
from desirepath.learning.scene_sets import Purpose, scene_set
from desirepath.simulation.environments import NavigationEnv
from desirepath.simulation.fast import rollout as roll_out
from desirepath.simulation.setups import get_setup, require_same

if TYPE_CHECKING:
    from desirepath.learning.policies.policy import Policy
    from desirepath.learning.queries.queries import Query
    from desirepath.report.findings import Findings, Who
    from desirepath.simulation.scene import Scene
    from desirepath.simulation.setups import Setup
    from desirepath.simulation.trajectory import Trajectory

__all__ = [
    "Posterior",
    "Report",
    "align",
    "draw_scenes",
    "evaluate",
    "get_setup",
    "load_policy",
    "load_queries",
    "make_env",
    "rollout",
]


def draw_scenes(setup: str, n: int, seed: int = 0) -> list[Scene]:
    """n fresh scenes of a setup, the same for the same seed; none that a policy was trained or chosen in.

    Raises SetupError for an unknown setup.
    """
    return scene_set(setup, n, purpose=Purpose.REPORT, seed=seed)


def rollout(policy: Policy, scenes: Sequence[Scene]) -> list[Trajectory]:
    """The policy once in every scene, on the fast engine: one trajectory per scene, in order.

    Raises SetupError where a scene is not of the policy's setup.
    """
    setup = get_setup(require_same(policy=policy.setup, **{f"scene {k}": one.setup for k, one in enumerate(scenes)}))
    return roll_out(setup, policy.rollout_policy, scenes)


def make_env(setup: str | Setup, **options: Any) -> NavigationEnv:
    """A Gymnasium environment of one robot; options as `NavigationEnv` takes them (`engine`, `seed`, `time_limit`)."""
    return NavigationEnv(setup, **options)


def evaluate(policy: Policy, n: int = 2_000, seed: int = 0) -> dict[str, Any]:
    """The policy in n fresh scenes: rates and means in SI units, `intervals` of 95 %; as `policies evaluate` says."""
    return evaluate_policy(policy, n=n, seed=seed)


@dataclass(frozen=True)
class Posterior:
    """What is believed of somebody's preference after some answers to queries of one setup; nothing is changed, every
    answer gives a new one."""

    setup: str
    belief: beliefs.Posterior

    @classmethod
    def prior(cls, setup: str) -> Posterior:
        """Before any answer. Raises SetupError for an unknown setup."""
        return cls(setup, beliefs.Posterior.prior(setup))

    @classmethod
    def fit(cls, queries: Sequence[Query], a_chosen: Sequence[bool]) -> Posterior:
        """After answers to these queries; a_chosen: whether A was chosen, of each.

        Raises LearningError for no queries or another number of answers, SetupError for queries of several setups.
        """
        if not queries:
            raise LearningError("queries = []: without an answer, begin with Posterior.prior(setup)")
        setup = require_same(**{f"query {k}": one.scene.setup for k, one in enumerate(queries)})
        return cls(setup, beliefs.Posterior.from_answers(setup, seen_in(queries), list(a_chosen)))

    def update(self, query: Query, a_chosen: bool) -> Posterior:
        """After one more answer."""
        return Posterior(self.setup, self.belief.updated(seen_in([query])[0], a_chosen))

    def ask_next(self, queries: QuerySet | Sequence[Query]) -> Query:
        """Of these candidates the query whose answer would tell most. Raises LearningError for no candidates."""
        asked = queries.queries if isinstance(queries, QuerySet) else queries
        if not asked:
            raise LearningError("queries = []: there is none to ask")
        candidates = Candidates(seen_in(asked), range(len(asked)))
        return asked[Information().ask_next(self.belief, candidates, np.random.default_rng(0)).index]

    def predict(self, queries: Sequence[Query]) -> np.ndarray[Any, np.dtype[np.float64]]:
        """(n,) probability that A is chosen."""
        return self.belief.predict(seen_in(queries))

    @property
    def weights(self) -> dict[str, float]:
        """Mean preference weights by objective, each in [0, 1]."""
        weights = zip(names_of(self.setup), self.belief.mean_weights(), strict=True)
        return {name: float(weight) for name, weight in weights}


def align(posterior: Posterior) -> Policy:
    """The setup's conditioned policy at what is believed: no training. Raises LearningError where none is shipped."""
    return load_conditioned(f"{posterior.setup}/conditioned").at(posterior.belief.mean_weights())


@dataclass(frozen=True)
class Report:
    """The report of an exported data set (a folder); who: `people`, `simulated` or `all`."""

    source: Path
    who: Who = "people"

    @property
    def findings(self) -> Findings:
        """Raises DatasetError for a folder that holds no data set, NothingToReport where nobody counts."""
        from desirepath.report.findings import analyse
        from desirepath.report.tidy_tables import read_folder

        return analyse(*read_folder(self.source), self.who)

    def write(self, out: Path) -> Path:
        """Write it into a folder, as `studies report` does; returns the HTML file, beside figures and tables."""
        from desirepath.report.study_report import write_study_report
        from desirepath.report.tidy_tables import read_folder

        return Path(write_study_report(*read_folder(self.source), out, who=self.who)["report"])
