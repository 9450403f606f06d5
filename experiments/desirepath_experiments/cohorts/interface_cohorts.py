"""The whole analysis of the interface study (chapter 7) over many cohorts: in which nothing differs, every test by
itself and whole families; and in which something was put in, whether it is found, and nothing else.

Everything here is simulated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from desirepath.analysis.repeated_measures import pairs_of
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.simulated_cohorts import (
    CONDITIONS,
    ITEMS,
    RANKINGS,
    VIEWS_DIFFER,
    Cohort,
    read_cohort,
    simulate_data,
)
from desirepath.report.simulated_power import COMPARISONS, FEW_QUERIES, analyse_simulated
from desirepath_experiments.benchmarks.results import Progress
from desirepath_experiments.cohorts.counting import count

OTHER_ITEM = "any item in which nothing was put, corrected"
OTHER_RANKING = "any ranking in which nothing was put, corrected"
OTHER_PAIR = "any pair of conditions that do not differ, of an item in which something was put"


@dataclass(frozen=True)
class NullConfig:
    """How many studies of how many people in which nothing differs."""

    cohorts: Annotated[int, Field(ge=1, description="Studies in which nothing differs, analysed whole.")] = 1_000
    participants: Annotated[int, Field(ge=2)] = 31
    seed: Annotated[int, Field(ge=0)] = 0


@dataclass(frozen=True)
class KnownConfig:
    """How many studies of how many people, and what differs."""

    cohort: Annotated[Path | None, Field(description="YAML of what is put in; default: two items and a ranking.")] = (
        None
    )
    cohorts: Annotated[int, Field(ge=1)] = 500
    participants: Annotated[int, Field(ge=2)] = 31
    seed: Annotated[int | None, Field(ge=0, description="Default: the cohort's own.")] = None


def benchmark_null_cohorts(config: NullConfig, progress: Progress | None = None) -> dict[str, Any]:
    """`rates`: of every test at alpha, and of whole families after correction, which must stay at alpha."""
    plan, size = AnalysisPlan(), config.participants
    cohort = Cohort(seed=config.seed)
    rates = count(config.cohorts, lambda k: _reject(cohort, size, k * size, plan))
    return _result(config.cohorts, size, plan) | {"seed": config.seed, "rates": [asdict(each) for each in rates]}


def benchmark_known_cohorts(config: KnownConfig, progress: Progress | None = None) -> dict[str, Any]:
    """As `known_cohorts`, of a file's cohort."""
    plan = AnalysisPlan()
    cohort = VIEWS_DIFFER if config.cohort is None else read_cohort(config.cohort)
    cohort = cohort if config.seed is None else replace(cohort, seed=config.seed)
    return _result(config.cohorts, config.participants, plan) | known_cohorts(
        cohort, config.cohorts, config.participants, plan
    )


def known_cohorts(cohort: Cohort, cohorts: int, participants: int, plan: AnalysisPlan) -> dict[str, Any]:
    """`rates`: shares of cohorts in which each item and ranking with something in it is found, and in which anything
    else is. Raises ValueError for an item or ranking that chapter 7 does not have."""
    for name, known in {"ratings": ITEMS, "first_choice": RANKINGS}.items():
        for key in getattr(cohort, name):
            if key not in known:
                raise ValueError(f"{name}.{key}: known are {', '.join(known)}")
    rates = count(cohorts, lambda k: _find(cohort, participants, k * participants, plan))
    return {"cohort": cohort.as_dict(), "rates": [asdict(each) for each in rates]}


def _result(cohorts: int, participants: int, plan: AnalysisPlan) -> dict[str, Any]:
    return {
        "simulated": True,
        "cohorts": cohorts,
        "participants": participants,
        "alpha": plan.alpha,
        "correction": plan.correction,
    }


def _reject(cohort: Cohort, participants: int, first: int, plan: AnalysisPlan) -> Iterator[tuple[str, bool]]:
    data = simulate_data(cohort, participants, first=first, queries=FEW_QUERIES, comparisons=COMPARISONS)
    findings, alpha = analyse_simulated(data, plan), plan.alpha
    items, rankings, own = findings.items, findings.rankings, findings.personalised
    yield from ((f"Friedman, {tested.item.key}", tested.test.p <= alpha) for tested in items)
    yield "Friedman, any item, corrected", any(tested.test.significant(alpha) for tested in items)
    rated = {
        (rating.item, rating.person, rating.condition): rating.value for rating in data.ratings if rating.condition
    }
    people = [row.code for row in data.people]
    for item in ITEMS:
        ratings = np.array([[rated[item, person, name] for name in CONDITIONS] for person in people])
        for pair, test in zip(combinations(CONDITIONS, 2), pairs_of(ratings, CONDITIONS, about=item), strict=True):
            yield f"Wilcoxon, {'/'.join(pair)}", test.p <= alpha
    pairs = [test for tested in items for test in tested.pairs]
    yield (
        "Wilcoxon, any pair of any item, after Friedman and Bonferroni",
        any(test.significant(alpha) for test in pairs),
    )
    yield from ((f"Chi-square, {ranking.item.key}", ranking.test.p <= alpha) for ranking in rankings)
    yield "Chi-square, any ranking, corrected", any(ranking.test.significant(alpha) for ranking in rankings)
    pairs = [test for ranking in rankings for test in ranking.pairs]
    yield "z, any pair of any ranking, after chi-square and Bonferroni", any(test.significant(alpha) for test in pairs)
    yield from ((f"Sign test, own against {comparison.against}", comparison.test.p <= alpha) for comparison in own)
    yield "Sign test, either, corrected", any(comparison.test.significant(alpha) for comparison in own)


def _find(cohort: Cohort, participants: int, first: int, plan: AnalysisPlan) -> Iterator[tuple[str, bool]]:
    findings = analyse_simulated(simulate_data(cohort, participants, first=first, queries=FEW_QUERIES), plan)
    others = dict.fromkeys((OTHER_ITEM, OTHER_RANKING, OTHER_PAIR), False)
    for item in findings.items:
        hit, shifts = item.test.significant(plan.alpha), cohort.ratings.get(item.item.key)
        if shifts is None:
            others[OTHER_ITEM] |= hit
            continue
        yield item.item.key, hit
        for (a, b), test in zip(combinations(CONDITIONS, 2), item.pairs, strict=False):  # none: not significant
            if shifts.get(a, 0.0) == shifts.get(b, 0.0):
                others[OTHER_PAIR] |= test.significant(plan.alpha)
    for ranking in findings.rankings:
        hit = ranking.test.significant(plan.alpha)
        if ranking.item.key in cohort.first_choice:
            yield ranking.item.key, hit
        else:
            others[OTHER_RANKING] |= hit
    yield from others.items()
