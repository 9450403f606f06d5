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

    Steps of queries that are chosen by the answers so far say by what (`choose`) instead of which (`query`); what is
    asked then stands in the trial. Probes of these say which step they repeat (`again`).

    Other queries are drawn without replacement and shown in random order; which of a query's drives is A is drawn by
    lot once per participant and query. Several blocks show the same queries with the same sides, each in its own order
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
    asked: dict[str, list[Step]] = {"learning": [], "regular": [], "probe": []}
    first = 0
    for entry in stage.trials:
        wanted = entry.queries
        mine = drawn[first : first + wanted.count]
        first += wanted.count
        if wanted.role == "learning":
            asked["learning"] += [_fixed("learning", query, turned[query.id]) for query in mine]
            continue
        place = len(asked["regular"])
        if wanted.choose == "random":
            asked["regular"] += [_fixed("regular", mine[i], turned[mine[i].id]) for i in random.permutation(len(mine))]
        else:
            rule = {"choose": wanted.choose} | ({"stop": wanted.stop.model_dump()} if wanted.stop else {})
            asked["regular"] += [{"role": "regular", "turned": bool(random.integers(2)), **rule} for _ in mine]
        again = random.choice(len(mine), wanted.probes.repeat + wanted.probes.swap, False)
        for n, i in enumerate(again):
            step = asked["regular"][place + int(i)]
            role = "repeat" if n < wanted.probes.repeat else "swap"
            probe = {**step, "role": role, "again": place + int(i)}
            if role == "swap":
                probe = _sides_changed(probe)
            probe.pop("stop", None)
            asked["probe"].append(probe)
    asked["probe"] = [asked["probe"][i] for i in random.permutation(len(asked["probe"]))]
    counted = len(asked["regular"]) + len(asked["probe"])
    learning = len(asked["learning"])
    steps: list[Step] = []
    for number, step in enumerate(asked["learning"] + asked["regular"] + asked["probe"], 1):
        practice = step["role"] == "learning"
        if "again" in step:
            step["again"] = f"{name}.{learning + step['again'] + 1:02d}"
        steps.append(
            {
                "key": f"{name}.{number:02d}",
                "kind": "trial",
                "stage": name,
                "block": name,
                "view": stage.view,
                "number": number if practice else number - learning,
                "of": learning if practice else counted,
                **step,
            }
        )
    return steps


def _fixed(role: str, query: AnyQuery, turned: bool) -> Step:
    """A query that is known before the session; `turned`: its second trajectory is shown as A."""
    step = {
        "role": role,
        "query": query.id,
        "turned": False,
        "trajectory_a": query.trajectory_a,
        "trajectory_b": query.trajectory_b,
        "duration_a_s": query.duration_a_s,
        "duration_b_s": query.duration_b_s,
    }
    return _sides_changed(step) if turned else step


def _sides_changed(step: Step) -> Step:
    changed = {**step, "turned": not step["turned"]}
    if "query" in step:
        for name in ("trajectory_{}", "duration_{}_s"):
            changed[name.format("a")], changed[name.format("b")] = step[name.format("b")], step[name.format("a")]
    return changed
