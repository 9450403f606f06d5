"""Makes the plan of one participant: the seeded list of steps. Pure; nothing here knows a clock or a database.

A step is plain data: `key` (unique in the plan), `kind`, `stage` (the stage's key), and what its kind needs; in a
block also `block` (the condition's name) and `view`, and `when` where not everybody meets it.
Kinds: information, consent, questionnaire, comprehension, instruction, trial, attention, demonstration, break, wait,
comparison, guess, appointment, debriefing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from backend.study.plan.counterbalancing import Place, design_of
from backend.study.plan.queries import AnyQuery, Drawn, PlanError, block_trials, draw, queries_needed
from backend.study.protocol import schema
from backend.study.protocol.blocks import BlockBreak, BlockEntry, BlockQuestionnaire, BlockStage, Condition
from backend.study.protocol.demonstration_stages import DemonstrationsStage, EvaluationStage
from backend.study.protocol.stages import (
    AppointmentStage,
    ComparisonStage,
    ComprehensionStage,
    QuestionnaireStage,
    Stage,
    StageEntry,
    TrainStage,
    stage_keys,
)

__all__ = ["AnyQuery", "PlanError", "Step", "appointments_of", "make_plan", "queries_needed", "session_seed"]

Step = dict[str, Any]


def session_seed(study_seed: int, code: str) -> int:
    """The seed of a participant's session: the same study seed and code give the same plan, 31 bits."""
    return int.from_bytes(hashlib.sha256(f"{study_seed}:{code}".encode()).digest()[:4], "big") >> 1


def make_plan(
    protocol: schema.Protocol, seed: int, queries: Sequence[AnyQuery], place: Place | None = None
) -> list[Step]:
    """The steps of one participant, all appointments together.

    place: the order of conditions that the assignment gave; default one by lot. Steps of queries that are chosen by the
    answers so far say by what (`choose`) instead of which (`query`); what is asked then stands in the trial. Probes say
    which step they repeat (`again`).

    Other queries are drawn without replacement and shown in random order; which of a query's drives is A is drawn by
    lot once per participant and query. Blocks and conditions show the same queries with the same sides, each in its own
    order (spec 07), unless `same_queries` is false. Probes come after all regular queries of their block have been
    seen. PlanError: too few queries.
    """
    random = np.random.default_rng([seed, 7])
    drawn = draw(protocol, queries, random)
    design = design_of(protocol)
    if place is None:
        place = design.place_by_lot(np.random.default_rng([seed, 13]))
    plan: list[Step] = []
    view = "top_down"
    for name, entry in zip(stage_keys(protocol.stages), protocol.stages, strict=True):
        stage = entry.stage
        if isinstance(stage, BlockStage):
            conditions = place[name].conditions(stage) if name in place else stage.conditions(0)
            steps = _block(name, stage, conditions, drawn, random)
            view = conditions[-1].view
        elif isinstance(stage, EvaluationStage):
            conditions = place[name].conditions(stage) if name in place else stage.conditions(0)
            steps = _evaluations(name, stage, conditions, protocol, random)
        else:
            steps = _pages(name, entry, protocol, view, random)
            view = stage.view if isinstance(stage, DemonstrationsStage) else view
        if isinstance(stage, TrainStage):
            plan[-1]["then"] = "train"  # with the answer to that step
        if entry.when is not None:
            for step in steps:
                step["when"] = entry.when.model_dump(by_alias=True, exclude_none=True)
        plan += steps
    return plan


def appointments_of(plan: list[Step]) -> list[list[Step]]:
    """The plan cut into its appointments; all but the last end with the step that says when to come back."""
    parts: list[list[Step]] = [[]]
    for step in plan:
        parts[-1].append(step)
        if step["kind"] == "appointment":
            parts.append([])
    return parts


def _pages(
    name: str, entry: StageEntry, protocol: schema.Protocol, view: str, random: np.random.Generator
) -> list[Step]:
    """The steps of a stage that is no block. view: of the block before."""
    stage: Stage = entry.stage
    step: Step = {"key": name, "kind": entry.kind, "stage": name}
    if isinstance(stage, TrainStage):
        steps: list[Step] = []
        if stage.meanwhile:
            used = stage.meanwhile.questionnaire
            steps.append({"key": f"{name}.{used}", "kind": "questionnaire", "stage": name, "questionnaire": used})
        if any(one.comparison for one in protocol.stages):  # otherwise there is nothing to wait for
            steps.append({"key": f"{name}.wait", "kind": "wait", "stage": name})
        return steps
    if isinstance(stage, DemonstrationsStage):
        return _drawings(name, stage, random)
    if isinstance(stage, ComparisonStage):
        against = [opponent for opponent in stage.opponents for _ in range(stage.scenes)]
        if len(stage.opponents) > 1:
            against = [against[i] for i in random.permutation(len(against))]
        shown: list[Step] = [
            {
                "key": f"{name}.{number}",
                "kind": "comparison",
                "stage": name,
                "view": stage.view or view,
                "number": number,
                "of": len(against),
                "turned": bool(random.integers(2)),
                **({"against": opponent} if opponent == "other" else {}),
            }
            for number, opponent in enumerate(against, 1)
        ]
        return [*shown, {"key": f"{name}.guess", "kind": "guess", "stage": name}] if stage.guess else shown
    if isinstance(stage, QuestionnaireStage):
        return [step | {"questionnaire": stage.use} | _limited(stage.time_limit_s)]
    if isinstance(stage, ComprehensionStage):
        numbers = range(1, stage.attempts + 1)
        said = {"questionnaire": stage.use, "attempts": stage.attempts, "on_failure": stage.on_failure}
        said |= ({"text": stage.text} if stage.text else {}) | _limited(stage.time_limit_s)
        return [step | {"key": f"{name}.{n}", "attempt": n, **said} for n in numbers]
    assert not isinstance(stage, BlockStage | EvaluationStage)  # noqa: S101  these are made elsewhere
    step["text"] = stage.text
    if isinstance(stage, BlockBreak):
        step["at_least_s"] = stage.at_least_s
    elif isinstance(stage, AppointmentStage):
        step |= {"after_days": stage.after_days, "within_days": stage.within_days}
    return [step]


def _drawings(name: str, stage: DemonstrationsStage, random: np.random.Generator) -> list[Step]:
    """One step per path that is drawn, situation by situation; those beyond `per_pair` can be left out."""
    return [
        {
            "key": f"{name}.{pair + 1}.{number}",
            "kind": "demonstration",
            "stage": name,
            "environment": stage.environment,
            "pair": pair,
            "view": stage.view,
            **({"person": stage.person} if stage.person != "still" else {}),
            "place": place,
            "places": stage.pairs,
            "number": number,
            "of": stage.per_pair if number <= stage.per_pair else stage.most_per_pair,
            "optional": number > stage.per_pair,
        }
        for place, pair in enumerate((int(i) for i in random.permutation(stage.pairs)), 1)
        for number in range(1, stage.most_per_pair + 1)
    ]


def _evaluations(
    name: str,
    stage: EvaluationStage,
    conditions: Sequence[Condition],
    protocol: schema.Protocol,
    random: np.random.Generator,
) -> list[Step]:
    """A wait for what is still being learned; then environment by environment, controller by controller: its drives,
    and the questions. Keys tell no controller.

    conditions: the controllers in the order of the first environment; the second has it in reverse.
    """
    drawn = {one.demonstrations.environment: one.demonstrations for one in protocol.stages if one.demonstrations}
    steps: list[Step] = [{"key": f"{name}.wait", "kind": "wait", "stage": name}]
    for turn, environment in enumerate(random.permutation(sorted(drawn)).tolist()):
        pairs = drawn[environment].pairs
        for place, controller in enumerate(conditions[::-1] if turn % 2 else conditions, 1):
            where: Step = {"stage": name, "block": controller.name, "view": stage.view, "environment": environment}
            prefix = f"{name}.{environment}.{place}"
            shown = {"robot": place, "of": pairs, "role": "regular"}
            steps += [
                {
                    "key": f"{prefix}.{pair + 1}",
                    "kind": "evaluation",
                    **where,
                    "pair": pair,
                    "number": pair + 1,
                    **shown,
                }
                for pair in range(pairs)
            ]
            asked = stage.questionnaire
            steps.append({"key": f"{prefix}.{asked}", "kind": "questionnaire", **where, "questionnaire": asked})
    return steps


def _limited(seconds: int | None) -> Step:
    return {"time_limit_s": seconds} if seconds is not None else {}


def _block(
    name: str, stage: BlockStage, conditions: Sequence[Condition], drawn: Drawn, random: np.random.Generator
) -> list[Step]:
    """The steps of a block, condition by condition; one without `each` or `one_of` is called as its stage."""
    steps: list[Step] = []
    for place, condition in enumerate(conditions):
        block = condition.name or name
        prefix = f"{name}.{condition.name}" if condition.name else name
        where: Step = {"stage": name, "block": block, "view": condition.view}
        between = stage.between if place else []
        steps += [_part(prefix, where, "between", n, one, condition) for n, one in enumerate(between, 1)]
        steps += [_part(prefix, where, "before", n, one, condition) for n, one in enumerate(stage.before, 1)]
        trials = block_trials(prefix, stage, drawn, random)
        steps += _with_attention(
            prefix, [{**where, **trial} for trial in trials], stage.attention_checks, where, random
        )
        steps += [_part(prefix, where, "after", n, one, condition) for n, one in enumerate(stage.after, 1)]
    return steps


def _part(prefix: str, where: Step, place: str, number: int, entry: BlockEntry, condition: Condition) -> Step:
    part = entry.part
    step: Step = {"kind": entry.kind, **where}
    if isinstance(part, BlockQuestionnaire):
        return {"key": f"{prefix}.{part.use}", **step, "questionnaire": part.use} | _limited(part.time_limit_s)
    step = {"key": f"{prefix}.{place}_{number}", **step, "text": condition.filled(part.text)}
    return step | {"at_least_s": part.at_least_s} if isinstance(part, BlockBreak) else step


def _with_attention(
    prefix: str, trials: list[Step], checks: int, where: Step, random: np.random.Generator
) -> list[Step]:
    """The trials with `checks` attention checks among the regular ones, at places drawn by lot, never side by side."""
    regular = [i for i, trial in enumerate(trials) if trial["role"] == "regular"]
    places = {regular[int(i)] for i in random.permutation(len(regular))[:checks]}
    steps: list[Step] = []
    number = 0
    for i, trial in enumerate(trials):
        if i in places:
            number += 1
            said = {"instructed": "ab"[int(random.integers(2))], "number": number}
            steps.append({"key": f"{prefix}.attention_{number}", "kind": "attention", **where, **said})
        steps.append(trial)
    return steps
