"""How often the analysis finds what a cohort was made with: power before recruiting. False findings, of cohorts in
which nothing differs, are counted in `experiments/cohorts`.

Everything here is simulated (`simulated_cohorts.py`); studies of simulated people are analysed as real ones are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from desirepath.analysis.estimates import wilson
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.explanation_findings import analyse_rankings
from desirepath.report.findings import Findings, NothingToReport, analyse
from desirepath.report.further_findings import Further
from desirepath.report.own_findings import ARMS
from desirepath.report.planned_design import Assumed, PlannedDesign, RankedDesign
from desirepath.report.report_cells import name_in_words, plural
from desirepath.report.simulated_rankers import RankerCohort, simulate_rankings
from desirepath.report.study_data import FACTORS, StudyData

Tell = Callable[[float], None]
FEW_QUERIES = 2  # of null cohorts: what is tested there are ratings, rankings and comparisons
COMPARISONS = 3
WANTED = 0.8  # power that is usually asked for (Cohen 1988)
EVIDENCE = 3.0  # Bayes factor that is often called evidence (Jeffreys 1961)
STANDS_FOR = {"attention": "outline"}  # either shows the scores, so that the simulated people are the same
FEWEST = 3  # people whom an analysis of variance can be made of
Found = Callable[[Findings], bool]
"""Whether findings have what was assumed."""


@dataclass(frozen=True)
class Rate:
    """How often something was found in `n` cohorts, with the 95 % Wilson interval."""

    test: str
    found: int
    n: int
    rate: float
    low: float
    high: float


def rate(test: str, significant: int, n: int) -> Rate:
    estimate = wilson(significant, n)
    return Rate(test, significant, n, significant / n, estimate.low, estimate.high)


def no_trajectories(trajectory: str) -> Any:
    """Simulated studies have no trajectories; their plans ask for no metrics."""
    raise LookupError(f"trajectory {trajectory!r}: simulated people saw none")


def analyse_simulated(data: StudyData, plan: AnalysisPlan, *, beside: bool = False) -> Findings:
    """A simulated study's analysis, as a real one's, without what needs trajectories. It has no other questionnaires.
    beside: with what stands beside the declared tests."""
    return analyse(
        data,
        no_trajectories,
        "simulated",
        plan.model_copy(update={"metrics": (), "items": None, "ranking": None}),
        intervals=False,
        beside=beside,
    )


@dataclass(frozen=True)
class Power:
    """One number of participants. agreement_half_width: of the 95 % interval of an agreement between conditions, mean
    over cohorts; None with fewer than two conditions."""

    participants: int
    rates: Sequence[Rate]
    agreement_half_width: float | None

    def rows(self) -> list[dict[str, object]]:
        """For a table or figure, one per test."""
        return [
            {"test": r.test, "participants": self.participants, "power": r.rate, "low": r.low, "high": r.high,
             "cohorts": r.n, "agreement_half_width": self.agreement_half_width}
            for r in self.rates
        ]  # fmt: skip


def power(
    design: PlannedDesign,
    assumed: Assumed,
    participants: Iterable[int],
    *,
    cohorts: int = 500,
    plan: AnalysisPlan | None = None,
    tell: Callable[[str], None] = lambda words: None,
) -> list[Power]:
    """Share of cohorts in which the analysis finds what was assumed, for each number of participants."""
    plan, cohort = plan or AnalysisPlan(), assumed.cohort(design.conditions)
    ranked = design.ranked
    rankers = assumed_cohort(ranked, assumed.tau, assumed.tau_gain, assumed.seed) if ranked.factors else None
    beside = dict(_beside_tests(design, assumed, plan))
    expected = dict(_tests(design, assumed, plan.alpha)) | beside
    results: list[Power] = []
    for size in participants:
        tell(f"{cohorts} studies of {size} participants are made up and analysed")
        counts: Counter[str] = Counter()
        widths = []
        for k in range(cohorts):
            try:
                findings = analyse_simulated(design.study(cohort, size, first=k * size), plan, beside=bool(beside))
            except NothingToReport:  # nobody finished
                continue
            counts.update(name for name, is_found in expected.items() if is_found(findings))
            widths += [of.share.high - of.share.mean for of in findings.between.values()]
        if rankers is not None:
            counts += count_found_rankings(ranked, rankers, size, cohorts, plan=plan, drop_out=assumed.drop_out)
        rates = [rate(test, counts[test], cohorts) for test in (*ranked.tests, *expected)]
        results.append(Power(size, rates, float(np.mean(widths)) if widths else None))
    return results


def _tests(design: PlannedDesign, assumed: Assumed, alpha: float) -> Iterator[tuple[str, Found]]:
    """The declared tests, in order: name, whether it found what was assumed."""
    if design.items and design.factors:
        for k, effect in enumerate(design.effects):
            yield _omnibus(design, effect, assumed), _item_found(assumed.item, k, alpha)
            if len(effect) == 1 and assumed.condition in design.factors[effect[0]]:
                yield from _against_others(design, effect[0], k, assumed, alpha)
    if design.rankings and len(design.conditions) > 1:
        number = len(design.rankings)
        yield (
            f"Chi-square, {assumed.ranking} (over {number} {plural(number, 'ranking')})",
            lambda of: any(
                ranking.item.key == assumed.ranking and ranking.test.significant(alpha) for ranking in of.rankings
            ),
        )
    for name in ("Sign test", "Signed ranks") if design.comparisons else ():
        for opponent in design.opponents:
            yield f"{name}, own against {opponent}", _own_found(name, opponent, alpha)


def _omnibus(design: PlannedDesign, effect: tuple[str, ...], assumed: Assumed) -> str:
    number = len(design.items) * len(design.effects)
    if len(design.factors) > 1:
        return f"{' × '.join(effect)}, {assumed.item} (over {number} {plural(number, 'test')})"
    two = len(design.factors[effect[0]]) == 2
    name = ("Mann-Whitney" if two else "Kruskal-Wallis") if design.between else ("Wilcoxon" if two else "Friedman")
    return f"{name}, {assumed.item} (over {number} {plural(number, 'item')})"


def _item_found(item: str, effect: int, alpha: float) -> Found:
    return lambda of: any(result.item.key == item and result.tests[effect].significant(alpha) for result in of.items)


def _against_others(
    design: PlannedDesign, factor: str, effect: int, assumed: Assumed, alpha: float
) -> Iterator[tuple[str, Found]]:
    """Whether the assumed level was found to differ from every other one of its factor, where there are several."""
    levels = design.factors[factor]
    if len(levels) < 3:
        return

    def is_found(findings: Findings) -> bool:
        for result in findings.items:
            if result.item.key == assumed.item:
                about = f"{result.tests[effect].about}, "
                pairs = [pair for pair in result.pairs if pair.about.startswith(about)]
                mine = [
                    pair
                    for names, pair in zip(combinations(levels, 2), pairs, strict=False)
                    if assumed.condition in names
                ]
                if mine and all(pair.significant(alpha) for pair in mine):
                    return True
        return False

    name = "Mann-Whitney" if factor in design.between else "Wilcoxon"
    others = "both others" if len(levels) == 3 else "all others"
    yield f"{name}, {'' if len(design.factors) == 1 else f'{factor}, '}against {others}", is_found


def _own_found(test: str, opponent: str, alpha: float) -> Found:
    """By the declared test corrected, by the other one as it is."""

    def is_found(findings: Findings) -> bool:
        for of in findings.personalised:
            if of.against == opponent:
                declared = (test == "Sign test") == (of.test.test == "Sign test")
                return of.test.significant(alpha) if declared else of.beside.p <= alpha
        return False

    return is_found


def _beside_tests(design: PlannedDesign, assumed: Assumed, plan: AnalysisPlan) -> Iterator[tuple[str, Found]]:
    """What the plan declares beside the tests: statement, whether findings make it.

    Equivalence is looked for in pairs of conditions that are assumed not to differ, and where the own policy is assumed
    to be preferred as often as not; evidence in the pairs that differ.
    """
    alpha, margins = plan.alpha, plan.equivalence
    conditions = next(iter(design.factors.values())) if len(design.factors) == 1 and not design.between else ()
    for pair in combinations(conditions, 2) if design.items else ():
        about = name_in_words(f"{assumed.item}, {pair[0]} against {pair[1]}")
        differs = assumed.effect != 0 and assumed.condition in pair
        if margins is not None and margins.rating is not None and not differs:
            yield f"Equivalence, {about}", _equivalent(f"{about}, within", alpha)
        if plan.bayes_factors and differs:
            yield f"Bayes factor of at least {EVIDENCE:g}, {about}", _evidence(about)
    if plan.models and len(conditions) > 1 and design.items:
        rating = f"rating of {name_in_words(assumed.item)}"
        yield f"Mixed model, {assumed.item} (uncorrected)", _model_finds(rating, alpha)
    for opponent in design.opponents if design.comparisons else ():
        own = assumed.own_against_other if opponent == "other" and assumed.own_against_other else assumed.own
        if margins is not None and margins.share is not None and own == 0.5:
            about = f"share of choices for the own policy against {ARMS[opponent]}"
            yield f"Equivalence, own against {opponent}", _equivalent(about, alpha)


def _beside(findings: Findings) -> Further:
    assert findings.further is not None  # noqa: S101  statements are counted in findings that have it
    return findings.further


def _equivalent(about: str, alpha: float) -> Found:
    return lambda of: any(test.about.startswith(about) and test.significant(alpha) for test in _beside(of).equivalent)


def _evidence(about: str) -> Found:
    return lambda of: any(of_two.about == about and of_two.factor >= EVIDENCE for of_two in _beside(of).weighed)


def _model_finds(about: str, alpha: float) -> Found:
    return lambda of: any(
        model.about == about and model.test is not None and model.test.p <= alpha for model in _beside(of).models
    )


def assumed_cohort(design: RankedDesign, tau: float, tau_gain: float, seed: int) -> RankerCohort:
    """People whose agreement rises from `tau` by `tau_gain` where the first factor that varies is shown. Raises
    CohortError for agreements that cannot be."""
    at = FACTORS.index(STANDS_FOR.get(design.factors[0], design.factors[0]))
    return RankerCohort(tau=tau, gain=(tau_gain * (at == 0), tau_gain * (at == 1), 0.0), seed=seed)


def count_found_rankings(
    design: RankedDesign,
    cohort: RankerCohort,
    participants: int,
    cohorts: int,
    *,
    plan: AnalysisPlan | None = None,
    drop_out: float = 0.0,
) -> Counter[str]:
    """In how many of so many simulated studies each test finds its effect after correction."""
    plan = plan or AnalysisPlan()
    factors = tuple(STANDS_FOR.get(factor, factor) for factor in design.factors)
    counts = Counter[str]()
    for k in range(cohorts):
        random = np.random.default_rng([cohort.seed, participants, k])
        finished = int(random.binomial(participants, 1 - drop_out))
        if finished < FEWEST:
            continue
        data = simulate_rankings(cohort, finished, first=k * participants, trials=design.trials, factors=factors)
        of = analyse_rankings(data.importance, (), plan, intervals=False)
        tests: Sequence[bool] = [test.significant(plan.alpha) for test in of.agreement.tests] if of else []
        counts.update(name for name, significant in zip(design.tests, tests, strict=False) if significant)
    return counts


def enough(powers: Sequence[Power]) -> dict[str, int | None]:
    """Of each test, the smallest number of participants tried that has a power of `WANTED`; None where none has."""
    tried = sorted(powers, key=lambda of: of.participants)
    reached = [(r.test, of.participants) for of in tried for r in of.rates if r.rate >= WANTED]
    return {r.test: next((n for test, n in reached if test == r.test), None) for of in tried[:1] for r in of.rates}
