"""The stage `block`: trials in one view or once per condition, with pages before, after and between them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from pydantic import Field, model_validator

from desirepath.grammar.conditions import Condition, Crossed
from desirepath.grammar.parts import an_example
from desirepath.grammar.source import Path, Problem, Source
from desirepath.study.kinds.attention import AttentionStep
from desirepath.study.kinds.feedback import TAKES_S, Feedback, check_beside_blind
from desirepath.study.kinds.order import Orders
from desirepath.study.kinds.trial import DEGREE_S, PairAnswers, Queries, Trials, TrialStep, Viewing, plan_trials
from desirepath.study.plan.asked_queries import Needs
from desirepath.study.protocol.pages_around import BlockEntry, PagesAround
from desirepath.study.steps import Pace, Planning, Stage, Step


class BlockStage(Crossed, PagesAround):
    """Trials in one view, or the same trials once per condition.

    view: of a block without conditions. each: factors that every participant meets in all combinations, in the order of
    the assignment. one_of: factors of which each participant meets one combination (between participants), balanced by
    the assignment as well. same_queries: all conditions, and all blocks that say so, show the participant's own
    queries, the same ones, with the sides kept, in an order of each one's own. before, after: pages of every condition;
    between: pages between two conditions. attention_checks: so many pages among the regular trials of each condition
    that say which letter to press (a preference has no wrong answer). answers: what may be said besides A or B.
    orders: several trajectories of a scene to put in order, among the regular trials at places drawn by lot. feedback:
    after every regular answer, how the robot would drive now; a condition of its own, which a study with anything blind
    cannot have.
    """

    model_config = an_example({"view": "top_down", "trials": [{"queries": {"count": 15}}]})

    asks: ClassVar[bool] = True
    teaches = "align"
    sets_view: ClassVar[bool] = True

    same_queries: bool = True
    before: list[BlockEntry] = []
    trials: list[Trials] = Field(min_length=1)
    after: list[BlockEntry] = []
    between: list[BlockEntry] = []
    viewing: Viewing = Viewing()
    answers: PairAnswers = PairAnswers()
    attention_checks: int = Field(0, ge=0, le=10)
    orders: list[Orders] = []
    feedback: Feedback | None = None

    @model_validator(mode="after")
    def _has_something_between(self) -> BlockStage:
        if self.between and not self.each:
            raise ValueError("'between' stands between the conditions of 'each'; this block has one condition only")
        return self

    # ---- what it needs and takes

    def needs(self) -> Needs:
        asked = sum(entry.queries.count for entry in self.trials)
        triads = sum(entry.queries.probes.transitivity for entry in self.trials)
        own = (self._orders + (0 if self.same_queries else asked)) * len(self.conditions(0))
        return Needs(asked if self.same_queries else 0, own, triads)

    @property
    def _orders(self) -> int:
        return sum(entry.count for entry in self.orders)

    def trials_asked(self) -> int:
        return (
            self._orders
            + sum(trial.queries.count + trial.queries.probes.trials for trial in self.trials)
            + self.attention_checks
        )

    def seconds(self, pace: Pace, stages: Sequence[Stage]) -> float:
        conditions = len(self.conditions(0))
        trials = conditions * sum(trial.queries.count + trial.queries.probes.trials for trial in self.trials)
        regular = sum(trial.queries.count for trial in self.trials if trial.queries.role == "regular")
        shown_s = conditions * regular * TAKES_S if self.feedback else 0.0
        trial_s = pace.trial_s + (DEGREE_S if self.answers.degree else 0.0)
        orders_s = conditions * sum(entry.count * entry.seconds_each(pace) for entry in self.orders)
        return trials * trial_s + self.pages() * pace.page_s + shown_s + orders_s

    def numbers(self) -> dict[str, int]:
        conditions = len(self.conditions(0))
        here = {"practice": 0, "regular": 0}
        for trial in self.trials:
            here[trial.queries.role] += trial.queries.count + trial.queries.probes.trials
        return {
            "blocks": conditions,
            "pairs_per_block": here["regular"],
            "pairs": here["regular"] * conditions,
            "practice_pairs": here["practice"] * conditions,
        }

    # ---- its steps

    def plan_condition(
        self, prefix: str, condition: Condition, where: Mapping[str, Any], at: Planning
    ) -> Iterable[Step]:
        asked = sum(entry.queries.count for entry in self.trials)
        pairs = iter(at.drawn.pairs(asked, shared=self.same_queries))
        triads = iter(at.drawn.triads)
        trials = plan_trials(prefix, where, self.trials, self.viewing, self.answers, pairs, triads, at.random)
        steps = _with_attention(prefix, trials, self.attention_checks, where, at.random)
        for k, entry in enumerate(self.orders):
            steps = _among(steps, entry.plan_steps(f"{prefix}.{k + 1}" if k else prefix, where, at.drawn), at.random)
        return self.feedback.after_each(prefix, where, steps) if self.feedback else steps

    # ---- what its numbers cannot be

    def problems(self, here: Path, stages: Sequence[Stage], source: Source) -> Iterator[Problem]:
        blocks = [stage for stage in stages if isinstance(stage, BlockStage)]
        several = sum(2 if block.each else 1 for block in blocks) > 1
        regular = 0
        for t, one in enumerate(self.trials):
            queries, at = one.queries, (*here, "trials", t, "queries")
            probes = queries.probes
            regular += queries.count * (queries.role == "regular")
            if probes.repeat + probes.swap > queries.count or (queries.role == "practice" and probes.trials):
                message = "asks for more probes than there are regular queries to ask again"
                yield source.problem((*at, "probes"), message)
            yield from _chosen(queries, at, several=several, source=source)
        if self.feedback:
            yield from check_beside_blind(stages, (*here, "feedback"), source)
        if not regular:
            yield source.problem((*here, "trials"), "has practice trials only; add queries of role regular")
        if self.attention_checks > regular > 0:
            message = f"is more than the {regular} regular queries of the block"
            yield source.problem((*here, "attention_checks"), message)


def _with_attention(
    prefix: str, trials: list[TrialStep], checks: int, where: Mapping[str, Any], random: np.random.Generator
) -> list[Step]:
    """The trials with `checks` attention checks among the regular ones, at places drawn by lot, never side by side."""
    regular = [i for i, trial in enumerate(trials) if trial.role == "regular"]
    places = {regular[int(i)] for i in random.permutation(len(regular))[:checks]}
    steps: list[Step] = []
    number = 0
    for i, trial in enumerate(trials):
        if i in places:
            number += 1
            fields = {"instructed": "ab"[int(random.integers(2))], "number": number}
            key = f"{prefix}.attention_{number}"
            steps.append(AttentionStep.model_validate({"key": key, "kind": "attention", **where, **fields}))
        steps.append(trial)
    return steps


def _among(steps: list[Step], orders: Sequence[Step], random: np.random.Generator) -> list[Step]:
    """The steps with orders, in their order, each before a regular trial or behind all of them."""
    regular = [i for i, step in enumerate(steps) if getattr(step, "role", "") == "regular"]
    places = sorted(int(i) for i in random.choice([*regular, regular[-1] + 1], len(orders)))
    for place, order in reversed([*zip(places, orders, strict=True)]):
        steps = [*steps[:place], order, *steps[place:]]
    return steps


def _chosen(queries: Queries, here: Path, *, several: bool, source: Source) -> Iterator[Problem]:
    """Where queries may follow the answers: not in practice, not where several blocks must show the same ones."""
    if queries.choose == "random":
        if queries.stop is not None:
            yield source.problem((*here, "stop"), "needs queries that are chosen by disagreement or information")
        return
    if queries.role == "practice":
        yield source.problem((*here, "choose"), "must be random for practice trials; their answers teach nothing")
    if several:
        yield source.problem(
            (*here, "choose"),
            "must be random, because this protocol's blocks show the same queries; keep one block in one view, or "
            "choose: random",
        )
    if queries.stop is not None and queries.stop.at_least > queries.count:
        yield source.problem((*here, "stop", "at_least"), f"is more than the {queries.count} queries there are")
