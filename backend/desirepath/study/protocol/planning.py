"""Makes the plan of one participant: the seeded list of steps. Pure; nothing here knows a clock or a database.

What steps a stage has is the stage's own (`kinds/`); here are the order of things and who meets which condition.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from desirepath.grammar.conditions import Ordered
from desirepath.study.plan.asked_queries import AnyQuery, Placeholder, PlanError, draw, placeholders
from desirepath.study.plan.counterbalancing import Place, design_of
from desirepath.study.steps import Planning, Step

if TYPE_CHECKING:
    from desirepath.study.protocol.schema import Protocol

__all__ = ["AnyQuery", "PlanError", "Step", "example_queries", "make_plan", "session_seed"]


def session_seed(study_seed: int, code: str) -> int:
    """The seed of a participant's session: the same study seed and code give the same plan, 31 bits."""
    return int.from_bytes(hashlib.sha256(f"{study_seed}:{code}".encode()).digest()[:4], "big") >> 1


def example_queries(protocol: Protocol) -> list[Placeholder]:
    """Queries that fill any plan of the protocol, for previews."""
    return placeholders(protocol.needs, protocol.sample)


def make_plan(protocol: Protocol, seed: int, queries: Sequence[AnyQuery], place: Place | None = None) -> list[Step]:
    """The steps of one participant, all appointments together.

    place: the order of conditions that the assignment gave; default one by lot. Steps of queries that are chosen by the
    answers so far say by what (`choose`) instead of which (`query`); what is asked then stands in the trial. Probes say
    which step they repeat (`again`).

    Other queries are drawn without replacement and shown in random order; which of a query's trajectories is A is drawn
    by lot once per participant and query. Blocks and conditions show the same queries with the same sides, each in its
    own order (ch. 7), unless `same_queries` is false. Probes come after all regular queries of their block have been
    seen. PlanError: too few queries.
    """
    random = np.random.default_rng([seed, 7])
    drawn = draw(protocol.needs, protocol.sample, queries, random)
    if place is None:
        place = design_of(protocol).place_by_lot(np.random.default_rng([seed, 13]))
    at = Planning(key="", stages=protocol.all_stages, conditions=(), view="top_down", drawn=drawn, random=random)
    plan: list[Step] = []
    for (at.key, stage), entry in zip(protocol.keyed_stages, protocol.stages, strict=True):
        at.conditions = ()
        if isinstance(stage, Ordered):
            at.conditions = place[at.key].conditions(stage) if at.key in place else stage.conditions(0)
        steps = stage.plan(at)
        if stage.sets_view and steps:
            at.view = steps[-1].view or at.view
        if stage.begins is not None:  # with the answer to the step before
            plan[-1] = plan[-1].model_copy(update={"then": stage.begins})
        if entry.when is not None:
            steps = [step.model_copy(update={"when": entry.when}) for step in steps]
        plan += steps
    return plan
