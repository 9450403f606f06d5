"""One tested result as a paper needs it, corrections of p for a family, means. The tests live in their own modules."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

Correction = Literal["holm", "bonferroni", "none"]
CORRECTION_WORDS: dict[str, str] = {"holm": "Holm", "bonferroni": "Bonferroni", "none": "uncorrected"}


@dataclass(frozen=True)
class Tested:
    """One test's result. `about`: what was compared, in words that a sentence goes on from ("rating of ease").

    symbol: of the statistic. df: degrees of freedom, None where the test has none. n: independent units (people).
    used: those of them that the test could use (no ties), where that is fewer. p_corrected: p itself until a family was
    corrected, by `correction`. effect: of the kind `effect_name`; direction: what a significant result says, in words.
    z: the statistic's normal approximation, where papers give it beside one of another kind.
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

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    def significant(self, alpha: float = 0.05) -> bool:
        """Whether the corrected p is at most alpha."""
        return self.p_corrected <= alpha

    @property
    def stars(self) -> str:
        """* up to 0.05, ** up to 0.01, *** up to 0.001 of the corrected p, as in the thesis's figures."""
        return stars(self.p_corrected)

    def sentence(self, alpha: float = 0.05) -> str:
        """The result in words, ready for a paper."""
        found = self.direction if self.significant(alpha) else "no difference was found"
        return f"{self.about[:1].upper()}{self.about[1:]}: {found}, {self.numbers()}."

    def numbers(self) -> str:
        """`chi2(2, N = 31) = 12.34, p = 0.002 (Holm), Kendall's W = 0.20`."""
        df = "" if self.df is None else f"{self.df:g}, "
        told_n = f"N = {self.n}" if self.used == self.n else f"N = {self.n}, {self.used} used"
        p = "" if self.correction == "uncorrected" else f" ({self.correction})"
        z = "" if self.z is None else f"z = {self.z:.2f}, "
        return (
            f"{self.symbol}({df}{told_n}) = {self.statistic:.2f}, {z}{told_p(self.p_corrected)}{p}, "
            f"{self.effect_name} = {self.effect:.2f}"
        )


def stars(p: float) -> str:
    """The thesis's marks: * up to 0.05, ** up to 0.01, *** up to 0.001."""
    return "".join("*" for bound in (0.05, 0.01, 0.001) if p <= bound)


def told_p(p: float) -> str:
    """p as papers write it."""
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}"


def holm(p: Sequence[float]) -> list[float]:
    """p corrected for their number by Holm's step-down method (1979), in the order given."""
    found = [0.0] * len(p)
    largest = 0.0
    for rank, k in enumerate(np.argsort(p, kind="stable")):
        largest = max(largest, min(1.0, (len(p) - rank) * p[k]))
        found[k] = largest
    return found


def corrected(tests: Sequence[Tested], how: Correction) -> list[Tested]:
    """The same tests, in their order, with p corrected for their number."""
    raw = [test.p for test in tests]
    found = {"holm": holm(raw), "bonferroni": [min(1.0, len(raw) * p) for p in raw], "none": raw}[how]
    words = CORRECTION_WORDS[how]
    return [replace(test, p_corrected=p, correction=words) for test, p in zip(tests, found, strict=True)]


@dataclass(frozen=True)
class Mean:
    """A mean of n numbers, standard deviation, standard error, 95 % interval (Student's t); NaN: unknown."""

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
    half = float(stats.t.ppf(0.975, len(data) - 1)) * se
    return Mean(len(data), mean, sd, se, mean - half, mean + half)
