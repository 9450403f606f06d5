"""p of few people against published tables, brute force and other programs, ties included."""

from __future__ import annotations

from itertools import combinations, permutations, product

import numpy as np
import pytest
from scipy import stats

from backend.analysis.exact import FEW, equal_shares, group_ranks, rank_sum, rank_totals, signed_ranks


def spread(totals: np.ndarray) -> float:
    return float(((totals - totals.mean()) ** 2).sum())


def ranks_with(totals: tuple[int, ...], n: int) -> np.ndarray:
    """Some ranks of n people that sum up to these totals."""
    k = len(totals)
    for rows in product(list(permutations(range(1, k + 1))), repeat=n):
        if tuple(np.sum(rows, axis=0)) == totals:
            return np.array(rows)
    raise AssertionError(totals)


@pytest.mark.parametrize(
    ("totals", "n", "chi2", "p"),
    [  # Siegel (1956), table N
        ((3, 6, 9), 3, 6.0, 0.028),
        ((5, 7, 12), 4, 6.5, 0.042),
        ((4, 8, 12), 4, 8.0, 0.0046),
        ((6, 10, 14), 5, 6.4, 0.039),
        ((3, 7, 9, 11), 3, 7.0, 0.054),
        ((3, 6, 10, 11), 3, 8.2, 0.017),
        ((2, 4, 6, 8), 2, 6.0, 0.042),
    ],
)
def test_friedman_s_p_is_that_of_the_published_table(totals: tuple, n: int, chi2: float, p: float) -> None:
    ranks = ranks_with(totals, n)
    assert stats.friedmanchisquare(*ranks.T).statistic == pytest.approx(chi2)
    found = rank_totals(ranks)
    assert found.method == "exact"
    assert found.p == pytest.approx(p, abs=0.0006)
    assert found.least == pytest.approx(1 / len(list(permutations(totals))) ** (n - 1))


@pytest.mark.parametrize(("n", "k", "points"), [(4, 3, 4), (5, 3, 7), (3, 4, 3)])
def test_friedman_s_p_with_ties_is_counted(n: int, k: int, points: int) -> None:
    random = np.random.default_rng(n * k)
    for _ in range(5):
        ranks = stats.rankdata(random.integers(1, points + 1, (n, k)), axis=1)
        observed = spread(ranks.sum(axis=0))
        everything = [spread(np.sum(rows, axis=0)) for rows in product(*[list(permutations(row)) for row in ranks])]
        found = rank_totals(ranks)
        assert found.p == pytest.approx(np.mean(np.array(everything) >= observed - 1e-9))
        assert found.least == pytest.approx(np.mean(np.array(everything) >= max(everything) - 1e-9))


def test_many_conditions_are_drawn_by_lot_and_many_people_approximated() -> None:
    ranks = stats.rankdata(np.random.default_rng(1).normal(size=(20, 5)), axis=1)
    found = rank_totals(ranks)
    assert found.method == "permutations"
    assert found.p == pytest.approx(stats.friedmanchisquare(*ranks.T).pvalue, abs=0.02)
    assert found.p == rank_totals(ranks).p  # the same data, the same lots
    assert found.least == 1 / 10_000
    assert rank_totals(np.array([[1.0, 2, 3, 4, 5]] * 2)).least == pytest.approx(1 / 120)
    many = stats.rankdata(np.random.default_rng(1).integers(1, 8, (FEW + 1, 3)), axis=1)
    assert rank_totals(many).method == "approximate"
    assert rank_totals(many).p == pytest.approx(stats.friedmanchisquare(*many.T).pvalue)


def test_signed_ranks_are_scipy_s_without_ties_and_counted_with_them() -> None:
    random = np.random.default_rng(3)
    differences = random.normal(0.4, 1, 12)
    ranks = stats.rankdata(np.abs(differences))
    assert signed_ranks(ranks, ranks[differences > 0].sum()).p == pytest.approx(stats.wilcoxon(differences).pvalue)
    tied = stats.rankdata([1, 1, 2, 3, 3, 3])
    sums = np.array([np.dot(tied, signs) for signs in product((0, 1), repeat=6)])
    for positive in (tied.sum(), tied.sum() - 1.5, 3.0, 10.5):
        expected = np.mean(np.abs(sums - tied.sum() / 2) >= abs(positive - tied.sum() / 2) - 1e-9)
        assert signed_ranks(tied, positive) == (pytest.approx(expected), 2 / 2**6, "exact")
    many = np.arange(1.0, FEW + 2)
    assert signed_ranks(many, 500.0).method == "approximate"
    z = (500 - many.sum() / 2) / np.sqrt((many**2).sum() / 4)
    assert signed_ranks(many, 500.0).p == pytest.approx(2 * stats.norm.sf(abs(z)))


def test_a_rank_sum_is_counted_over_every_choice_of_so_many() -> None:
    ranks = stats.rankdata([1, 1, 2, 2, 2, 5, 6])
    sums = np.array([ranks[list(chosen)].sum() for chosen in combinations(range(7), 3)])
    for total in sorted(set(sums)):
        expected = np.mean(np.abs(sums - 3 * ranks.mean()) >= abs(total - 3 * ranks.mean()) - 1e-9)
        found = rank_sum(ranks, 3, total)
        assert (found.p, found.method) == (pytest.approx(expected), "exact")
    far = np.abs(sums - 3 * ranks.mean())
    assert rank_sum(ranks, 3, sums[0]).least == pytest.approx(np.mean(far >= far.max() - 1e-9))
    first, second = np.random.default_rng(2).integers(1, 8, (2, 40))
    many = stats.rankdata(np.concatenate([first, second]))
    theirs = stats.mannwhitneyu(first, second, method="asymptotic", use_continuity=False).pvalue
    assert rank_sum(many, 40, many[:40].sum()) == (pytest.approx(theirs), 0.0, "approximate")


def test_divisions_into_groups_are_drawn_by_lot() -> None:
    """All 1,680 divisions of nine people into three groups of three, against 9,999 lots."""
    ranks = np.array([1, 2, 4.5, 3, 4.5, 6, 7, 8, 9])

    def statistic(order: tuple) -> float:
        return sum(np.sum(part) ** 2 for part in np.split(np.array(order), 3))

    ways = [
        (*a, *b, *sorted(set(range(9)) - set(a) - set(b)))
        for a in combinations(range(9), 3)
        for b in combinations(sorted(set(range(9)) - set(a)), 3)
    ]
    expected = np.mean([statistic(ranks[list(way)]) >= statistic(ranks) - 1e-9 for way in ways])
    found = group_ranks(ranks, (3, 3, 3))
    assert found.method == "permutations"
    assert found.p == pytest.approx(expected, abs=0.01)
    assert found.least == pytest.approx(6 / 1680)
    many = stats.rankdata(np.random.default_rng(0).integers(1, 8, 60))
    theirs = stats.kruskal(many[:20], many[20:40], many[40:]).pvalue
    assert group_ranks(many, (20, 20, 20)) == (pytest.approx(theirs), 0.0, "approximate")


def test_equal_shares_are_counted_over_all_that_so_many_can_choose() -> None:
    """Six of six choose the same of three: 3 of 3^6 ways. Eight people, by hand over all 3^8 ways."""
    assert equal_shares([6, 0, 0]) == (pytest.approx(3 / 3**6), pytest.approx(3 / 3**6), "exact")
    counts = np.array([np.bincount(way, minlength=3) for way in product(range(3), repeat=8)])
    squares = (counts**2).sum(axis=1)
    for seen in ([4, 3, 1], [5, 2, 1], [3, 3, 2]):
        assert equal_shares(seen).p == pytest.approx(np.mean(squares >= np.square(seen).sum()))
    assert equal_shares([30, 20, 10]) == (pytest.approx(stats.chisquare([30, 20, 10]).pvalue), 0.0, "approximate")
