"""What a plan declares beside the tests, and what of it a planned study should then say: equivalence of what does not
differ, evidence by Bayes factors, mixed models. How often it does is counted in `simulated_power.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import combinations

from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import Findings
from desirepath.report.further_findings import Further
from desirepath.report.own_findings import ARMS
from desirepath.report.planned_design import Assumed, PlannedDesign
from desirepath.report.rating_findings import name_in_words

EVIDENCE = 3.0  # Bayes factor that is often called evidence (Jeffreys 1961)
Said = Callable[[Findings], bool]


def statements(design: PlannedDesign, assumed: Assumed, plan: AnalysisPlan) -> Mapping[str, Said]:
    """Statement -> whether findings make it. Empty where the plan declares nothing beside the tests.

    Equivalence is looked for in pairs of conditions that are assumed not to differ, and where the own policy is assumed
    to be preferred as often as not; evidence in the pairs that differ.
    """
    found: dict[str, Said] = {}
    conditions = next(iter(design.factors.values())) if len(design.factors) == 1 and not design.between else ()
    for pair in combinations(conditions, 2) if design.items else ():
        about = f"{assumed.item}, {pair[0]} against {pair[1]}".replace("_", " ")
        differs = assumed.effect != 0 and assumed.condition in pair
        if plan.equivalence is not None and plan.equivalence.rating is not None and not differs:
            found[f"Equivalence, {about}"] = _equivalent(f"{about}, within", plan.alpha)
        if plan.bayes_factors and differs:
            found[f"Bayes factor of at least {EVIDENCE:g}, {about}"] = _evidence(about)
    if plan.models and len(conditions) > 1 and design.items:
        found[f"Mixed model, {assumed.item} (uncorrected)"] = _modelled(
            f"rating of {name_in_words(assumed.item)}", plan.alpha
        )
    for opponent in design.opponents if design.comparisons else ():
        own = assumed.own_against_other if opponent == "other" and assumed.own_against_other else assumed.own
        if plan.equivalence is not None and plan.equivalence.share is not None and own == 0.5:
            of = f"share of choices for the own policy against {ARMS[opponent]}"
            found[f"Equivalence, own against {opponent}"] = _equivalent(of, plan.alpha)
    return found


def _beside(findings: Findings) -> Further:
    assert findings.further is not None  # noqa: S101  statements are counted in findings that have it
    return findings.further


def _equivalent(about: str, alpha: float) -> Said:
    return lambda of: any(one.about.startswith(about) and one.significant(alpha) for one in _beside(of).equivalent)


def _evidence(about: str) -> Said:
    return lambda of: any(one.about == about and one.factor >= EVIDENCE for one in _beside(of).weighed)


def _modelled(about: str, alpha: float) -> Said:
    return lambda of: any(
        one.about == about and one.test is not None and one.test.p <= alpha for one in _beside(of).models
    )
