"""Makes the shipped stand-ins: simulated people drawn from the prior answer queries; what their answers speak for is
kept where the policy conditioned on it passes the gate. What they are for: `learning/policies/stand_ins.py`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from desirepath.learning.alignment.gate import GateRule, at_gate
from desirepath.learning.cards import source_commit
from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.stand_ins import StandInCard, card_file
from desirepath.learning.preferences.objectives import NAMES
from desirepath.learning.preferences.posterior import Posterior
from desirepath.learning.preferences.spans import seen_in
from desirepath.learning.queries.queries import QuerySet
from desirepath.learning.shipping.storing import Request

PEOPLE = 24  # as many can finish together before anybody's policy is ready
ANSWERS = 15  # as in study_protocols/personalisation_study.yaml
QUERY_SET = "queries_varied_200"
TRIED = 10  # times as many are drawn: who is given the same weights as another one, or whose policy fails, is none


def ship_stand_ins(request: Request) -> StandInCard:
    """Draw, ask, and store the setup's stand-ins."""
    setup, seed = request.setup, request.seed
    base, conditioned = Policy.load(request.path("base")), ConditionedPolicy.load(request.path("conditioned"))
    differences = seen_in(QuerySet.load(request.path(QUERY_SET)).queries)
    prior = Posterior.prior(setup)
    drawn = prior.sample(TRIED * PEOPLE)
    random = np.random.default_rng([seed, 71])
    people: list[dict[str, Any]] = []
    for number in random.permutation(len(drawn.weights)).tolist():
        pairs = differences[random.choice(len(differences), ANSWERS, replace=False)]
        chosen = random.random(ANSWERS) < drawn.choice_probabilities(pairs)[number]
        posterior = prior
        for difference, a_chosen in zip(pairs, chosen, strict=True):
            posterior = posterior.updated(difference, bool(a_chosen))
        weights = posterior.mean_weights()
        named = {name: round(float(w), 4) for name, w in zip(NAMES, weights, strict=True) if w}
        if any(named == person["weights"] for person in people):
            continue  # it would be the same policy
        gate = at_gate(conditioned.at(weights), base, GateRule(), seed=seed)
        if gate.passed:
            people.append(
                {
                    "prefers": {
                        name: round(float(w), 3) for name, w in zip(NAMES, drawn.weights[number], strict=True) if w
                    },
                    "weights": named,
                    "gate_success": gate.success_rate,
                }
            )  # fmt: skip
            request.on_progress(len(people) / PEOPLE, {"success": gate.success_rate})
        if len(people) == PEOPLE:
            break
    card = StandInCard(
        setup=setup,
        command=f"desirepath ship stand-ins {setup} --seed {seed}",
        seed=seed,
        commit=source_commit(),
        query_set=f"{setup}/{QUERY_SET}",
        answers=ANSWERS,
        people=people,
        parents=request.parents("base", "conditioned", QUERY_SET),
        notes=[
            "Simulated people, drawn from the prior of `learning/preferences/posterior.py`, answered queries drawn by "
            "lot as that model says; `weights`: what recipe instant would give a participant with these answers.",
            "They are lent only while no other participant's policy is ready; reports say so.",
        ],
    )
    card.save(card_file(setup, request.folder))
    return card
