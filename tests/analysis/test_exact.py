"""p of few people against published tables, brute force and other programs, ties included."""

from __future__ import annotations

from itertools import combinations, permutations, product

import numpy as np
import pytest
from scipy import stats

from desirepath.analysis.exact import FEW, equal_shares, group_ranks, rank_sum, rank_totals, signed_ranks


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


def test_what_is_counted_and_what_is_drawn_by_lot_follows_from_the_number_of_cases() -> None:
    """At most 200,000 states: totals of k - 1 conditions from 0 to 2 n (k - 1), or ways to share n choices times k."""
    random = np.random.default_rng(6)

    def way(n: int, k: int) -> str:
        return rank_totals(stats.rankdata(random.normal(size=(n, k)), axis=1)).method

    assert [way(n, 3) for n in (3, FEW, FEW + 1)] == ["exact", "exact", "approximate"]
    assert [way(n, 4) for n in (9, 10)] == ["exact", "permutations"]  # 55^3 and 61^3
    assert [way(n, 5) for n in (2, 3)] == ["exact", "permutations"]  # 17^4 and 25^4
    assert [equal_shares([n, 0, 0, 0, 0, 0]).method for n in (17, 18)] == ["exact", "approximate"]
    assert [equal_shares([n, 0]).method for n in (FEW, FEW + 1)] == ["exact", "approximate"]
    tied = np.ones(FEW)
    assert signed_ranks(tied, 10).method == rank_sum(tied, 20, 400.0).method == "exact"
    assert group_ranks(np.arange(FEW), (20, 20, 10)).method == "permutations"
    assert group_ranks(np.arange(FEW + 1), (20, 20, 11)).method == "approximate"


def test_of_lots_the_data_count_as_one_so_that_p_is_a_multiple_of_a_ten_thousandth() -> None:
    random = np.random.default_rng(7)
    ranks = stats.rankdata(random.normal(size=(12, 5)), axis=1)
    groups = stats.rankdata(random.normal(size=12))
    for found in (rank_totals(ranks), rank_totals(ranks, seed=3), group_ranks(groups, (4, 4, 4))):
        assert found.p * 10_000 == pytest.approx(round(found.p * 10_000), abs=1e-6)
        assert 0 < found.least <= found.p < 1
    assert rank_totals(ranks).p != rank_totals(ranks, seed=3).p
    assert rank_totals(np.tile(np.arange(1.0, 6), (12, 1))).p == 1 / 10_000
    assert group_ranks(np.arange(20.0), (7, 7, 6)).p == 1 / 10_000
    assert group_ranks(np.ones(9), (3, 3, 3)).p == 1.0


def test_no_p_is_above_one() -> None:
    for n in (2, 3, 7, 20, 50):
        middle = np.arange(1.0, n + 1)
        assert signed_ranks(middle, middle.sum() / 2).p <= 1
        assert rank_sum(middle, n // 2, n // 2 * (n + 1) / 2).p <= 1
        alike = rank_totals(np.full((n, 3), 2.0))
        assert (alike.p, alike.least) == (pytest.approx(1), pytest.approx(1))
        assert max(alike[:2]) <= 1
        latin = rank_totals(np.array([[1.0, 2, 3], [2, 3, 1], [3, 1, 2]] * n)[: FEW - FEW % 3])
        assert latin.p == pytest.approx(1.0)
        assert latin.p <= 1
        assert equal_shares([n, n]).p <= 1
    assert signed_ranks([1.0], 1.0) == (1.0, 1.0, "exact")
    assert signed_ranks([1.0, 2.0], 3.0) == (0.5, 0.5, "exact")


def test_groups_of_different_sizes_have_a_least_p_of_their_own() -> None:
    """5! / (2! 2! 1!) = 30 divisions; two groups have the same size, so that 2 of them are as extreme."""
    assert group_ranks([1, 2, 3, 4, 5], (2, 2, 1)).least == pytest.approx(2 / 30)
    assert group_ranks([1, 2, 3, 4, 5, 6], (3, 2, 1)).least == pytest.approx(1 / 60)
    assert group_ranks([1, 2, 3], (1, 1, 1)).least == 1.0


def test_many_people_s_ranks_are_scipy_s_ties_included() -> None:
    random = np.random.default_rng(9)
    table = stats.rankdata(random.integers(1, 5, (60, 4)), axis=1)
    assert rank_totals(table).p == pytest.approx(stats.friedmanchisquare(*table.T).pvalue)
    assert rank_totals(table).least == 0.0
    differences = random.integers(-3, 5, 70)
    kept = differences[differences != 0]
    ranks = stats.rankdata(np.abs(kept))
    theirs = stats.wilcoxon(kept, correction=False, method="asymptotic").pvalue
    assert signed_ranks(ranks, ranks[kept > 0].sum()) == (pytest.approx(theirs), 0.0, "approximate")
    first, second = random.integers(1, 6, 45), random.integers(1, 7, 20)
    both = stats.rankdata(np.concatenate([first, second]))
    theirs = stats.mannwhitneyu(first, second, method="asymptotic", use_continuity=False).pvalue
    assert rank_sum(both, 45, both[:45].sum()).p == pytest.approx(theirs)
    sizes = (30, 12, 18)
    parts = np.split(random.integers(1, 6, 60), np.cumsum(sizes)[:-1])
    assert group_ranks(stats.rankdata(np.concatenate(parts)), sizes).p == pytest.approx(stats.kruskal(*parts).pvalue)
