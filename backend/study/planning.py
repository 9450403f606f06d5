"""Makes the plan of one session: the seeded list of its steps. Pure; nothing here knows a clock or a database.

A step is plain data: `key` (unique in the session), `kind`, `stage` (the stage's key), and what its kind needs.
Kinds: information, consent, questionnaire, instruction, trial, wait, comparison, guess, debriefing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from backend.study import schema
from backend.study.protocol import stage_keys

Step = dict[str, Any]


class PlanError(ValueError):
    """A query set that cannot fill the protocol."""


class AnyQuery(Protocol):
    """What a plan needs to know of a query."""

    @property
    def id(self) -> str: ...
    @property
    def setup(self) -> str: ...
    @property
    def trajectory_a(self) -> str: ...
    @property
    def trajectory_b(self) -> str: ...
    @property
    def duration_a_s(self) -> float: ...
    @property
    def duration_b_s(self) -> float: ...


def session_seed(study_seed: int, code: str) -> int:
    """The seed of a participant's session: the same study seed and code give the same plan, 31 bits."""
    return int.from_bytes(hashlib.sha256(f"{study_seed}:{code}".encode()).digest()[:4], "big") >> 1


def queries_needed(protocol: schema.Protocol) -> int:
    """How many different queries one session shows."""
    return max(
        sum(entry.queries.count for entry in stage.trials)
        for stage in (entry.stage for entry in protocol.stages)
        if isinstance(stage, schema.BlockStage)
    )


def make_plan(protocol: schema.Protocol, seed: int, queries: Sequence[AnyQuery]) -> list[Step]:
    """The steps of one session.

    Queries are drawn without replacement and shown in random order; which of a query's drives is A is drawn by lot once
    per participant and query. Several blocks show the same queries with the same sides, each in its own order
    (spec 07). Probes come after all regular queries of their block have been seen. PlanError: too few queries.
    """
    needed = queries_needed(protocol)
    if len(queries) < needed:
        raise PlanError(f"the query set has {len(queries)} queries, one session of this protocol needs {needed}")
    random = np.random.default_rng([seed, 7])
    drawn = [queries[i] for i in random.choice(len(queries), size=needed, replace=False)]
    turned = {query.id: bool(random.integers(2)) for query in drawn}
    plan: list[Step] = []
    view = "top_down"
    for name, entry in zip(stage_keys(protocol.stages), protocol.stages, strict=True):
        stage = entry.stage
        if isinstance(stage, schema.BlockStage):
            view = stage.view
            plan += _block(name, stage, drawn, turned, random)
        elif isinstance(stage, schema.TrainStage):
            plan[-1]["then"] = "train"  # with the answer to that step
            if stage.meanwhile:
                plan.append(
                    {
                        "key": f"{name}.{stage.meanwhile.questionnaire}",
                        "kind": "questionnaire",
                        "stage": name,
                        "questionnaire": stage.meanwhile.questionnaire,
                    }
                )
            if any(one.comparison for one in protocol.stages):  # otherwise there is nothing to wait for
                plan.append({"key": f"{name}.wait", "kind": "wait", "stage": name})
        elif isinstance(stage, schema.ComparisonStage):
            for number in range(1, stage.scenes + 1):
                plan.append(
                    {
                        "key": f"{name}.{number}",
                        "kind": "comparison",
                        "stage": name,
                        "view": stage.view or view,
                        "number": number,
                        "of": stage.scenes,
                        "turned": bool(random.integers(2)),
                    }
                )
            if stage.guess:
                plan.append({"key": f"{name}.guess", "kind": "guess", "stage": name})
        elif isinstance(stage, schema.QuestionnaireStage):
            plan.append({"key": name, "kind": "questionnaire", "stage": name, "questionnaire": stage.use})
        else:
            plan.append({"key": name, "kind": entry.kind, "stage": name})
    return plan


def _block(
    name: str,
    stage: schema.BlockStage,
    drawn: Sequence[AnyQuery],
    turned: dict[str, bool],
    random: np.random.Generator,
) -> list[Step]:
    regular: list[tuple[str, AnyQuery, bool]] = []
    learning: list[tuple[str, AnyQuery, bool]] = []
    probes: list[tuple[str, AnyQuery, bool]] = []
    first = 0
    for entry in stage.trials:
        wanted = entry.queries
        chosen = drawn[first : first + wanted.count]
        first += wanted.count
        if wanted.role == "learning":
            learning += [("learning", query, turned[query.id]) for query in chosen]
            continue
        regular += [("regular", chosen[i], turned[chosen[i].id]) for i in random.permutation(len(chosen))]
        again = [chosen[i] for i in random.choice(len(chosen), wanted.probes.repeat + wanted.probes.swap, False)]
        probes += [("repeat", query, turned[query.id]) for query in again[: wanted.probes.repeat]]
        probes += [("swap", query, not turned[query.id]) for query in again[wanted.probes.repeat :]]
    probes = [probes[i] for i in random.permutation(len(probes))]
    counted = len(regular) + len(probes)
    steps: list[Step] = []
    for number, (role, query, other_way) in enumerate(learning + regular + probes):
        drives = [
            {"trajectory": query.trajectory_a, "duration_s": query.duration_a_s},
            {"trajectory": query.trajectory_b, "duration_s": query.duration_b_s},
        ]
        a, b = reversed(drives) if other_way else drives
        steps.append(
            {
                "key": f"{name}.{number + 1:02d}",
                "kind": "trial",
                "stage": name,
                "block": name,
                "role": role,
                "view": stage.view,
                "number": number + 1 if role == "learning" else number + 1 - len(learning),
                "of": len(learning) if role == "learning" else counted,
                "query": query.id,
                "turned": other_way,
                "trajectory_a": a["trajectory"],
                "trajectory_b": b["trajectory"],
                "duration_a_s": a["duration_s"],
                "duration_b_s": b["duration_s"],
            }
        )
    return steps
