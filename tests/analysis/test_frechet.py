"""Frechet distances against answers known by hand and a decision procedure written another way."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from desirepath.analysis.frechet import deviation, frechet_distance, prefix_distances

STRAIGHT = np.stack([np.linspace(0, 10, 21), np.zeros(21)], axis=1)


def interval(p: np.ndarray, a: np.ndarray, b: np.ndarray, reach: float) -> tuple[float, float] | None:
    """The part of segment a-b within reach of p, found through the foot of the perpendicular."""
    length = float(np.linalg.norm(b - a))
    if length == 0:
        return (0.0, 1.0) if np.linalg.norm(p - a) <= reach else None
    along = float((p - a) @ (b - a)) / length
    aside = float(np.linalg.norm(p - a - along * (b - a) / length))
    if aside > reach:
        return None
    half = math.sqrt(reach * reach - aside * aside)
    low, high = max(0.0, (along - half) / length), min(1.0, (along + half) / length)
    return (low, high) if low <= high else None


def within(a: np.ndarray, b: np.ndarray, reach: float, *, whole: bool) -> bool:
    """The reference decision: can one walk a to its end beside b (to its end if `whole`) within reach?

    By dictionaries of reachable intervals and a plain recursion over edges, nothing shared with the product's loop.
    """
    if np.linalg.norm(a[0] - b[0]) > reach:
        return False
    n, m = len(a) - 1, len(b) - 1

    def vertical(i: int, j: int) -> tuple[float, float] | None:  # a at vertex i, along segment j of b
        free = interval(a[i], b[j], b[j + 1], reach)
        if free is None:
            return None
        if i == 0:
            if j == 0:
                return free if free[0] == 0 else None
            below = vertical(0, j - 1)
            return free if below and below[1] == 1 and free[0] == 0 else None
        if known_h.get((i - 1, j)):
            return free
        entry = known_v.get((i - 1, j))
        return (max(free[0], entry[0]), free[1]) if entry and max(free[0], entry[0]) <= free[1] else None

    def horizontal(i: int, j: int) -> tuple[float, float] | None:  # b at vertex j, along segment i of a
        free = interval(b[j], a[i], a[i + 1], reach)
        if free is None:
            return None
        if j == 0:
            if i == 0:
                return free if free[0] == 0 else None
            before = known_h.get((i - 1, 0))
            return free if before and before[1] == 1 and free[0] == 0 else None
        if known_v.get((i, j - 1)):
            return free
        entry = known_h.get((i, j - 1))
        return (max(free[0], entry[0]), free[1]) if entry and max(free[0], entry[0]) <= free[1] else None

    known_v: dict[tuple[int, int], tuple[float, float] | None] = {}
    known_h: dict[tuple[int, int], tuple[float, float] | None] = {}
    for total in range(n + m + 1):
        for i in range(n + 1):
            j = total - i
            if 0 <= j < m:
                known_v[i, j] = vertical(i, j)
            if i < n and 0 <= j <= m:
                known_h[i, j] = horizontal(i, j)
    if whole:
        last = known_v[n, m - 1]
        return last is not None and last[1] == 1 and bool(np.linalg.norm(a[-1] - b[-1]) <= reach)
    return any(known_v.get((n, j)) is not None for j in range(m))


def paths(points: int) -> st.SearchStrategy[np.ndarray]:
    numbers = st.floats(-3, 3).map(lambda x: round(x, 3))
    return st.lists(st.tuples(numbers, numbers), min_size=2, max_size=points, unique=True).map(np.array)


def crossings(points: int) -> st.SearchStrategy[np.ndarray]:
    """Paths along the crossings of a grid, which stand still, turn back and pass through each other's points."""
    places = st.integers(-2, 2).map(float)
    return st.lists(st.tuples(places, places), min_size=2, max_size=points).map(np.array)


@settings(max_examples=60, deadline=None)
@given(paths(7) | crossings(7), paths(7) | crossings(7))
def test_every_distance_lies_where_the_reference_decision_turns(a: np.ndarray, b: np.ndarray) -> None:
    exact = frechet_distance(a, b)
    assert within(a, b, exact + 1e-9, whole=True)
    assert exact < 2e-9 or not within(a, b, exact - 1e-9, whole=True)
    prefixes = prefix_distances(a, b)
    for i in range(1, len(a)):
        assert within(a[: i + 1], b, prefixes[i] + 1e-9, whole=False)
        assert prefixes[i] < 2e-9 or not within(a[: i + 1], b, prefixes[i] - 1e-9, whole=False)
    assert (np.diff(prefixes) >= -1e-9).all()
    assert frechet_distance(b, a) == pytest.approx(exact, abs=1e-9)
    assert prefixes[-1] <= exact + 1e-9


def discrete_distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n, m): the discrete distance of every pair of prefixes (Eiter and Mannila 1994), a bound for ours."""
    table = np.linalg.norm(np.asarray(a)[:, None] - np.asarray(b)[None], axis=2)
    for i, j in np.ndindex(table.shape):
        before = [table[p] for p in ((i - 1, j), (i, j - 1), (i - 1, j - 1)) if min(p) >= 0]
        table[i, j] = max(table[i, j], min(before, default=0.0))
    return table


def shortest_leash(a: np.ndarray, b: np.ndarray) -> float:
    """The discrete distance by its definition (Eiter and Mannila 1994): the shortest leash, among all distances of two
    points, with which dog and walker get from both starts to both ends, point by point, neither ever going back. (The
    library that this was compared with before is wrong in one pair of two hundred.)"""
    distances = np.array([[math.dist(p, q) for q in b] for p in a])

    def arrive(leash: float) -> bool:
        open_pairs, seen = [(0, 0)], set()
        while open_pairs:
            i, j = pair = open_pairs.pop()
            if pair in seen or i == len(a) or j == len(b) or distances[pair] > leash:
                continue
            if pair == (len(a) - 1, len(b) - 1):
                return True
            seen.add(pair)
            open_pairs += [(i + 1, j), (i, j + 1), (i + 1, j + 1)]
        return False

    return next(leash for leash in sorted(set(distances.ravel().tolist())) if arrive(leash))


@settings(max_examples=30, deadline=None)
@given(paths(7), paths(7))
def test_the_discrete_distance_is_the_shortest_leash_and_never_smaller(a: np.ndarray, b: np.ndarray) -> None:
    discrete = discrete_distances(a, b)
    assert discrete[-1, -1] == pytest.approx(shortest_leash(a, b), abs=1e-12)
    assert discrete[-1, -1] >= frechet_distance(a, b) - 1e-9
    assert (discrete.min(axis=1) >= prefix_distances(a, b) - 1e-9).all()


def test_cases_that_are_known_by_hand() -> None:
    assert frechet_distance(STRAIGHT, STRAIGHT + np.array([0.0, 2.0])) == pytest.approx(2.0, abs=1e-9)
    assert frechet_distance(STRAIGHT, STRAIGHT[[0, -1]]) == pytest.approx(0.0, abs=1e-9)
    assert discrete_distances(STRAIGHT, STRAIGHT[[0, -1]])[-1, -1] == pytest.approx(5.0)
    # Forth, back by 2 and forth again: who never turns back is at best 1 m off.
    forth_and_back = np.array([[0, 0], [6, 0], [4, 0], [10, 0]], dtype=float)
    assert frechet_distance(forth_and_back, STRAIGHT) == pytest.approx(1.0, abs=1e-9)
    # A triangle's apex against the straight line below it.
    assert frechet_distance([[0, 0], [5, 3], [10, 0]], STRAIGHT) == pytest.approx(3.0, abs=1e-9)
    assert frechet_distance([[1.0, 2.0]], STRAIGHT) == pytest.approx(math.hypot(9, 2), abs=1e-9)


def test_a_path_that_is_followed_perfectly_deviates_at_its_end() -> None:
    found = deviation(STRAIGHT, STRAIGHT[::4])
    assert (found.t_star, found.backwards) == (1.0, False)
    assert found.distance_m == pytest.approx(0, abs=1e-3)
    # The demonstration may go on further than the trajectory.
    assert deviation(STRAIGHT[:11], STRAIGHT).t_star == 1.0


def test_the_deviation_point_is_where_the_rollout_turns_off() -> None:
    turned = np.concatenate([STRAIGHT[:15], STRAIGHT[14] + np.stack([np.zeros(12), np.linspace(0.5, 6, 12)], axis=1)])
    found = deviation(turned, STRAIGHT + np.array([0.0, 0.1]))
    assert found.t_star == pytest.approx(7.0 / 13.0, abs=0.05)
    assert found.point == pytest.approx((7.0, 0.1), abs=0.6)
    assert 0.09 < found.distance_m < 0.3


def test_where_the_ends_meet_both_paths_are_read_backwards() -> None:
    late = np.concatenate([np.stack([np.full(10, 3.0), np.linspace(-5, -0.5, 10)], axis=1), STRAIGHT[6:]])
    found = deviation(late, STRAIGHT)
    assert found.backwards
    assert found.t_star == pytest.approx(7 / 12, abs=0.08)


def test_what_is_no_path_is_refused() -> None:
    with pytest.raises(ValueError, match="b has shape"):
        frechet_distance(STRAIGHT, np.zeros((0, 2)))
    with pytest.raises(ValueError, match="rollout has shape"):
        deviation([[0.0, math.nan]], STRAIGHT)


def finely(path: np.ndarray, step: float) -> np.ndarray:
    """The same path with points at most `step` apart."""
    parts = [np.linspace(p, q, 2 + int(math.dist(p, q) / step))[:-1] for p, q in pairwise(path)]
    return np.concatenate([*parts, path[-1:]])


def test_between_close_points_the_discrete_distance_is_hardly_larger() -> None:
    """Eiter and Mannila (1994): by no more than the longest step. Of whole paths and of every prefix."""
    random = np.random.default_rng(5)
    for n, m in ((2, 2), (3, 9), (9, 3), (8, 8), (2, 7), (12, 5)) * 2:
        a, b = np.cumsum(random.normal(0, 1, (n, 2)), axis=0), np.cumsum(random.normal(0, 1, (m, 2)), axis=0)
        dense, other = finely(a, 0.2), finely(b, 0.2)
        discrete = discrete_distances(dense, other)
        upper = discrete[-1, -1]
        assert upper - 0.2 <= frechet_distance(a, b) <= upper + 1e-9
        at = np.array([np.flatnonzero((dense == p).all(axis=1))[0] for p in a])
        prefixes = discrete.min(axis=1)[at]
        found = prefix_distances(a, b)
        assert (found <= prefixes + 1e-9).all()
        assert (found >= prefixes - 0.2).all()
        # A detour of the one that comes back to where it was is as far as its far end, whoever makes it.
        away = np.concatenate([a[: n // 2 + 1], a[n // 2] + [[0.0, 50.0]], a[n // 2 :]])
        assert frechet_distance(away, b) == pytest.approx(frechet_distance(b, away), abs=1e-9)
        assert frechet_distance(away, b) > 40


def test_a_coarse_answer_is_as_near_as_it_says() -> None:
    aside = STRAIGHT + np.array([0.0, 2.0])
    for exact in (0.5, 0.1, 1e-3):
        assert 2.0 <= frechet_distance(STRAIGHT, aside, exact_m=exact) <= 2.0 + exact
        coarse = prefix_distances(STRAIGHT, aside, exact_m=exact)
        assert ((coarse >= 2.0) & (coarse <= 2.0 + exact)).all()
    random = np.random.default_rng(1)
    a, b = random.normal(size=(2, 6, 2))
    assert frechet_distance(a, b, exact_m=0.05) == pytest.approx(frechet_distance(a, b), abs=0.05)
    assert prefix_distances(a, b, exact_m=0.05) == pytest.approx(prefix_distances(a, b), abs=0.05)


def test_who_stands_still_is_as_far_as_the_other_goes() -> None:
    """One point, or the same one over and over: the farthest point of the other path, on either side."""
    for still in ([[1.0, 2.0]], [[1.0, 2.0]] * 2, [[1.0, 2.0]] * 4):
        assert frechet_distance(still, STRAIGHT) == pytest.approx(math.hypot(9, 2), abs=1e-9)
        assert frechet_distance(STRAIGHT, still) == pytest.approx(math.hypot(9, 2), abs=1e-9)
        assert prefix_distances(still, STRAIGHT) == pytest.approx([math.hypot(1, 2)] * len(still), abs=1e-9)
        along = prefix_distances(STRAIGHT, still)
        assert along == pytest.approx(np.maximum.accumulate(np.hypot(STRAIGHT[:, 0] - 1, 2)), abs=1e-9)
    assert frechet_distance([[1.0, 1.0]], [[4.0, 5.0]]) == pytest.approx(5.0, abs=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_the_deviation_point_is_the_best_of_all_by_its_formula(seed: int) -> None:
    """C(t) = cos(3 pi / 4) f(t) + sin(3 pi / 4) t over the points; read from the nearer pair of ends, wherever the
    origin lies. Both paths the other way round are compared the same way."""
    random = np.random.default_rng(seed)
    origin = np.array([7.0, -11.0])
    a = np.cumsum(random.normal(0.4, 0.5, (12, 2)), axis=0) + origin
    b = np.cumsum(random.normal(0.4, 0.5, (9, 2)), axis=0) + origin + random.normal(0, 1, 2)
    found, other = deviation(a, b, exact_m=1e-9), deviation(a[::-1], b[::-1], exact_m=1e-9)
    assert found.backwards == (math.dist(a[-1], b[-1]) < math.dist(a[0], b[0]))
    assert other.backwards != found.backwards
    assert other == type(found)(found.t_star, found.distance_m, found.point, other.backwards, found.cost)
    if found.backwards:
        a, b = a[::-1], b[::-1]
    share = np.array([sum(math.dist(a[k], a[k + 1]) for k in range(i)) for i in range(len(a))])
    share /= share[-1]
    apart = prefix_distances(a, b)
    costs = (share - apart) / math.sqrt(2)
    best = int(np.argmax(costs))
    assert (found.t_star, found.distance_m, found.cost) == pytest.approx((share[best], apart[best], costs[best]))
    assert found.point == pytest.approx(tuple(a[best]))


def test_ends_as_near_as_the_starts_are_read_forwards_and_of_equal_points_the_latest_counts() -> None:
    found = deviation(STRAIGHT, STRAIGHT + np.array([0.0, 1.0]))
    assert not found.backwards
    assert found.point == (10.0, 0.0)
    still = deviation([[1.0, 1.0], [1.0, 1.0]], STRAIGHT)
    assert (still.t_star, still.distance_m) == (1.0, pytest.approx(math.sqrt(2), abs=1e-3))


def test_a_third_column_is_not_looked_at_and_one_alone_is_no_path() -> None:
    turned = np.column_stack([STRAIGHT, np.linspace(0, 99, len(STRAIGHT))])
    assert frechet_distance(turned, STRAIGHT) == pytest.approx(0.0, abs=1e-9)
    for bad in (np.zeros((4, 1)), np.zeros(4), np.zeros((2, 3, 2)), [[0.0, math.inf]]):
        with pytest.raises(ValueError, match="a has shape"):
            prefix_distances(bad, STRAIGHT)
