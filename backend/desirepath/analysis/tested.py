"""One tested result as a paper needs it, corrections of p for a family, means. The tests live in their own modules."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

Correction = Literal["holm", "bonferroni", "none"]
NO_SPREAD = "no spread, not testable"
ROUNDING = 1e-10  # of numbers around 1 (ratings, shares, metres, seconds): what differs less is the same
CORRECTION_WORDS: dict[str, str] = {"holm": "Holm", "bonferroni": "Bonferroni", "none": "uncorrected"}


@dataclass(frozen=True)
class Tested:
    """One test's result. `about`: what was compared, in words that a sentence goes on from ("rating of ease").

    symbol: of the statistic. df: degrees of freedom, None where the test has none. n: independent units (people).
    used: those of them that the test could use (no ties), where that is fewer. p_corrected: p itself until a family was
    corrected, by `correction`. effect: of the kind `effect_name`; direction: what a significant result says, in words.
    z: the statistic's normal approximation, where papers give it beside one of another kind. df_error: of an F.

    method: how p was found: exact, by permutations (by lot), or approximate. least_p: the smallest p that so few people
    with such ties can give (0: as small as you like), least_p_corrected: the same after correction. effect_low,
    effect_high: 95 % interval of the effect; shift, with its interval: in the unit of what was measured. no_spread:
    nobody differed from anybody, so there is nothing to test; p is 1, which no correction makes significant.
    """

    test: str
    about: str
    symbol: str
    statistic: float
    df: float | None
    p: float
    p_corrected: float
    correction: str
    effect_name: str
    effect: float
    n: int
    used: int
    direction: str
    z: float | None = None
    df_error: float | None = None
    method: str = "approximate"
    least_p: float = 0.0
    least_p_corrected: float = 0.0
    effect_low: float = math.nan
    effect_high: float = math.nan
    shift: float | None = None
    shift_low: float = math.nan
    shift_high: float = math.nan
    no_spread: bool = False

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    def significant(self, alpha: float = 0.05) -> bool:
        """Whether the corrected p is at most alpha."""
        return self.p_corrected <= alpha

    def possible(self, alpha: float = 0.05) -> bool:
        """Whether so few people could have given a significant result at all."""
        return self.least_p_corrected <= alpha

    def stars(self, alpha: float = 0.05) -> str:
        """The marks of the corrected p (`stars`)."""
        return stars(self.p_corrected, alpha)

    def sentence(self, alpha: float = 0.05) -> str:
        """The result in words, ready for a paper. Who could not have found anything is told so."""
        if self.no_spread:
            return f"{self.about[:1].upper()}{self.about[1:]}: {self.numbers()}."
        result = "no difference was found"
        if self.significant(alpha):
            result = self.direction
        elif not self.possible(alpha):
            result += f" and none could be with so few people (p cannot be below {self.least_p_corrected:.3f})"
        return f"{self.about[:1].upper()}{self.about[1:]}: {result}, {self.numbers()}."

    def numbers(self) -> str:
        """`chi2(2, N = 31) = 12.34, p = 0.002 (Holm), Kendall's W = 0.20`."""
        if self.no_spread:
            return f"{NO_SPREAD} (N = {self.n})"
        df = "" if self.df is None else f"{self.df:.4g}, "
        df += "" if self.df_error is None else f"{self.df_error:.4g}, "
        n_in_words = f"N = {self.n}" if self.used == self.n else f"N = {self.n}, {self.used} used"
        p = f" ({', '.join(w for w in (self.method, self.correction) if w not in ('approximate', 'uncorrected'))})"
        p = "" if p == " ()" else p
        interval = "" if math.isnan(self.effect_low) else f" [{self.effect_low:.2f}, {self.effect_high:.2f}]"
        z = "" if self.z is None else f"z = {self.z:.2f}, "
        return (
            f"{self.symbol}({df}{n_in_words}) = {self.statistic:.2f}, {z}{p_in_words(self.p_corrected)}{p}, "
            f"{self.effect_name} = {self.effect:.2f}{interval}"
        )


def star_bounds(alpha: float = 0.05) -> list[float]:
    """Up to which p a mark is given each: alpha, and of 0.01 and 0.001 what lies below it."""
    return [alpha, *(bound for bound in (0.01, 0.001) if bound < alpha)]


def stars(p: float, alpha: float = 0.05) -> str:
    """Marks of a p: one per bound, so that nothing that is not significant has any. With alpha = 0.05 the thesis's."""
    return "".join("*" for bound in star_bounds(alpha) if p <= bound)


def p_in_words(p: float) -> str:
    """p as papers write it."""
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}"


def holm(p: Sequence[float]) -> list[float]:
    """p corrected for their number by Holm's step-down method (1979), in the order given. statsmodels' `multipletests`
    says the same, but collects garbage in each call: 50 ms, where a power analysis corrects thousands of families."""
    corrected = [0.0] * len(p)
    largest = 0.0
    for rank, k in enumerate(np.argsort(p, kind="stable")):
        largest = max(largest, min(1.0, (len(p) - rank) * p[k]))
        corrected[k] = largest
    return corrected


def correct_tests(tests: Sequence[Tested], how: Correction) -> list[Tested]:
    """The same tests, in their order, with p corrected for their number."""
    corrected, least = _correct([t.p for t in tests], how), _correct([t.least_p for t in tests], how)
    words = CORRECTION_WORDS[how]
    return [
        replace(test, p_corrected=p, least_p_corrected=low, correction=words)
        for test, p, low in zip(tests, corrected, least, strict=True)
    ]


def _correct(raw: Sequence[float], how: Correction) -> list[float]:
    return {"holm": holm(raw), "bonferroni": [min(1.0, len(raw) * p) for p in raw], "none": list(raw)}[how]


def name_pairs(names: Sequence[str], about: str) -> Iterator[tuple[int, int, str, tuple[str, str]]]:
    """Every two of what is compared: their places, what is tested of them in words, their names."""
    for i, j in combinations(range(len(names)), 2):
        yield i, j, f"{about}, {names[i]} against {names[j]}", (names[i], names[j])


def correct_pairs(tests: Sequence[Tested], over: int | None, gate: Tested | None) -> list[Tested]:
    """The tests of all pairs of one item's conditions, corrected for their number and for the number of items.

    over: in how many items pairs are tested; None: as the thesis, for these pairs alone (Bonferroni). gate: the item's
    test over all conditions, where only its being significant lets the pairs be tested. Each item has alpha / over
    (Bonferroni). Behind the gate not all conditions can be alike, so with k of them at most (k - 1) (k - 2) / 2 pairs
    can (Shaffer 1986; one of three): p is multiplied by that many, and is no smaller than the gate's. Without a gate it
    is multiplied by the number of pairs. So in all items and pairs together something that does not differ is found in
    at most alpha of studies.
    """
    if over is None:
        return correct_tests(tests, "bonferroni")
    count = len(tests)
    conditions = round((1 + math.sqrt(1 + 8 * count)) / 2)
    factor = over * (count if gate is None else max(1, (conditions - 1) * (conditions - 2) // 2))
    floor, lowest = (0.0, 0.0) if gate is None else (over * gate.p, over * gate.least_p)
    words = "Bonferroni" if gate is None else "Shaffer" if over == 1 else "Shaffer, Bonferroni over the items"
    return [
        replace(
            test,
            p_corrected=min(1.0, max(floor, factor * test.p)),
            least_p_corrected=min(1.0, max(lowest, factor * test.least_p)),
            correction=words,
        )
        for test in tests
    ]


def has_spread(values: ArrayLike) -> bool:
    """Whether some of the numbers (n,) differ by more than rounding does."""
    data = np.asarray(values, dtype=float)
    return data.size > 1 and bool(np.ptp(data) > ROUNDING * max(1.0, float(np.abs(data).max())))


@dataclass(frozen=True)
class Mean:
    """A mean of n numbers, standard deviation, standard error, 95 % interval (Student's t); NaN: unknown, as the
    interval is where everybody said the same."""

    n: int
    mean: float
    sd: float
    se: float
    low: float
    high: float


def mean_of(values: ArrayLike) -> Mean:
    """Mean of (n,), numbers that are not finite left out. Of none all is NaN, of one all but the mean."""
    data = np.asarray(values, dtype=float)
    data = data[np.isfinite(data)]
    if len(data) < 2:
        return Mean(len(data), float(data[0]) if len(data) else math.nan, *[math.nan] * 4)
    mean, sd = float(data.mean()), float(data.std(ddof=1))
    se = sd / math.sqrt(len(data))
    if not has_spread(data):
        return Mean(len(data), mean, sd, se, math.nan, math.nan)
    from scipy import stats  # 0.6 s: reading a protocol and serving pages do without

    half = float(stats.t.ppf(0.975, len(data) - 1)) * se
    return Mean(len(data), mean, sd, se, mean - half, mean + half)
