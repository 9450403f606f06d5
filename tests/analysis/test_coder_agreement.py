"""Agreement of two coders, against the kappas of textbooks and the formula of their standard error."""

from __future__ import annotations

import math

import numpy as np
import pytest

from desirepath.analysis.choices import cohens_kappa
from desirepath.analysis.coder_agreement import agreement_on, agreement_on_all


def codings(both: int, first_only: int, second_only: int, neither: int) -> tuple[list[set[str]], list[set[str]]]:
    first = [{"x"}] * (both + first_only) + [set()] * (second_only + neither)
    second = [{"x"}] * both + [set()] * first_only + [{"x"}] * second_only + [set()] * neither
    return first, second


def standard_error(table: tuple[int, int, int, int]) -> float:
    """Fleiss, Cohen and Everitt (1969), equation 13, for two categories."""
    p = np.array(table, dtype=float).reshape(2, 2) / sum(table)
    rows, columns = p.sum(1), p.sum(0)
    observed, chance = np.trace(p), float(rows @ columns)
    diagonal = sum(p[i, i] * ((1 - chance) - (columns[i] + rows[i]) * (1 - observed)) ** 2 for i in (0, 1))
    beside = (1 - observed) ** 2 * sum(p[i, 1 - i] * (columns[i] + rows[1 - i]) ** 2 for i in (0, 1))
    rest = (observed * chance - 2 * chance + observed) ** 2
    return math.sqrt((diagonal + beside - rest) / sum(table)) / (1 - chance) ** 2


@pytest.mark.parametrize(
    ("table", "kappa"),
    [
        ((20, 5, 10, 15), 0.40),  # 50 grant proposals: the example that most textbooks take
        ((45, 15, 25, 15), 0.1304),  # two tables with the same agreement of 0.6, as discussed since Feinstein (1990)
        ((25, 35, 5, 35), 0.2593),
    ],
)
def test_kappa_and_its_interval_are_those_of_the_textbooks(table, kappa):
    found = agreement_on("x", *codings(*table))
    assert found.kappa == pytest.approx(kappa, abs=5e-4)
    assert found.kappa == pytest.approx(cohens_kappa(*[["x" in one for one in c] for c in codings(*table)]))
    assert found.high - found.kappa == pytest.approx(1.959964 * standard_error(table), rel=1e-4)
    assert found.n == sum(table)
    assert found.agreement == pytest.approx((table[0] + table[3]) / sum(table))


def test_what_chance_explains_alone_has_no_kappa():
    nobody = agreement_on("x", *codings(0, 0, 0, 9))
    assert (nobody.agreement, math.isnan(nobody.kappa)) == (1.0, True)
    assert math.isnan(agreement_on("x", [], []).kappa)
    assert math.isnan(agreement_on_all(["x"], [], []).kappa)


def test_over_all_codes_kappa_is_pooled_and_its_interval_is_over_answers():
    """de Vries et al. 2008: with one code it is Cohen's; codes that hardly occur do not carry it off."""
    one = codings(20, 5, 10, 15)
    assert agreement_on_all(["x"], *one).kappa == pytest.approx(agreement_on("x", *one).kappa)
    assert agreement_on_all(["x"], *one).low == agreement_on("x", *one).low
    assert math.isnan(agreement_on("x", *codings(4, 0, 0, 5)).low)  # always the same: no interval, not [-1, 1]
    pooled = agreement_on_all(["x", "rare"], *one)
    assert pooled.kappa == pytest.approx((0.85 - 0.75) / (1 - 0.75))
    assert pooled.low < pooled.kappa < pooled.high
    rng = np.random.default_rng(3)
    inside = 0
    for _ in range(60):  # two who agree on what is there with probability 0.9 each
        truth = rng.random(80) < 0.4
        a, b = (np.where(rng.random(80) < 0.9, truth, ~truth) for _ in range(2))
        found = agreement_on_all(["x"], [{"x"} if x else set() for x in a], [{"x"} if x else set() for x in b])
        share = 0.4 * 0.9 + 0.6 * 0.1
        chance = share**2 + (1 - share) ** 2
        inside += found.low <= (0.82 - chance) / (1 - chance) <= found.high
    assert inside >= 52
