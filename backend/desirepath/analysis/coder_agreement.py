"""How far two coders agree who gave codes to the same answers: Cohen's kappa (1960) per code and over all codes.

Several codes may fit one answer, so each code is a decision of its own: it fits, or not. What was coded is the
caller's.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from statsmodels.stats.inter_rater import cohens_kappa

from desirepath.analysis.estimates import Doubles, resample_means
from desirepath.analysis.intervals import UNKNOWN

Codes = Collection[str]


@dataclass(frozen=True)
class CoderAgreement:
    """Agreement on one code (`code`), or on all of them (None), over n answers.

    both, first_only, second_only, neither: to how many answers (over all codes: decisions) who gave it. kappa is NaN
    where chance alone would give full agreement, as for a code that nobody used. low, high: its 95 % interval, NaN
    where the answers tell none, as where both always said the same.
    """

    code: str | None
    n: int
    both: int
    first_only: int
    second_only: int
    neither: int
    kappa: float
    low: float
    high: float

    @property
    def agreement(self) -> float:
        """Share of equal decisions; NaN for none."""
        decisions = self.both + self.first_only + self.second_only + self.neither
        return (self.both + self.neither) / decisions if decisions else math.nan


def agreement_on(code: str, first: Sequence[Codes], second: Sequence[Codes]) -> CoderAgreement:
    """Agreement on one code; first, second (n,): the codes that each coder gave to the same n answers.

    The interval is from kappa's standard error for large n (Fleiss, Cohen and Everitt 1969), kept within [-1, 1]; with
    few answers it is rough.
    """
    table = _table(_mark_answers(code, first), _mark_answers(code, second))
    result = cohens_kappa(table) if 0 < _expected_agreement(table) < 1 else None
    low, high = (result.kappa_low, result.kappa_upp) if result and result.var_kappa > 0 else UNKNOWN
    return _agreement(code, len(first), table, result.kappa if result else math.nan, low, high)


def agreement_on_all(
    codes: Sequence[str], first: Sequence[Codes], second: Sequence[Codes], *, seed: int = 0
) -> CoderAgreement:
    """Pooled kappa over all codes (de Vries et al. 2008): observed and expected agreement are averaged over the codes.

    Decisions on one answer depend on each other, so the interval is from answers drawn anew with replacement. Of a
    single code it is that code's own (`agreement_on`).
    """
    if len(codes) == 1:
        return replace(agreement_on(codes[0], first, second), code=None)
    a = np.array([_mark_answers(code, first) for code in codes], dtype=bool).reshape(len(codes), len(first))
    b = np.array([_mark_answers(code, second) for code in codes], dtype=bool).reshape(len(codes), len(second))
    table = _table(a.ravel(), b.ravel())
    kappa, low, high = math.nan, *UNKNOWN
    if a.size:
        answers = np.concatenate([(a == b).mean(axis=0, keepdims=True), a, b]).T
        kappa = float(_pool_kappa(answers.mean(axis=0, keepdims=True))[0])
        drawn = _pool_kappa(resample_means(answers, seed=seed))
        known = drawn[np.isfinite(drawn)]
        if len(first) > 1 and len(known) and math.isfinite(kappa):
            low, high = (float(end) for end in np.quantile(known, (0.025, 0.975)))
    return _agreement(None, len(first), table, kappa, low, high)


def _agreement(
    code: str | None, n: int, table: NDArray[np.int64], kappa: float, low: float, high: float
) -> CoderAgreement:
    (both, first_only), (second_only, neither) = table.tolist()
    return CoderAgreement(
        code,
        n,
        both,
        first_only,
        second_only,
        neither,
        float(kappa),
        max(float(low), -1.0),
        min(float(high), 1.0),  # NaN stays NaN
    )


def _mark_answers(code: str, codings: Sequence[Codes]) -> NDArray[np.bool_]:
    return np.array([code in codes for codes in codings], dtype=bool)


def _table(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> NDArray[np.int64]:
    """[[both, first only], [second only, neither]]."""
    return np.array([[(a & b).sum(), (a & ~b).sum()], [(~a & b).sum(), (~a & ~b).sum()]], dtype=np.int64)


def _expected_agreement(table: NDArray[np.int64]) -> float:
    """Agreement by chance, from how often each of the two gave the code. NaN for no answers."""
    n = table.sum()
    return float((table.sum(0) * table.sum(1)).sum() / n**2) if n else math.nan


def _pool_kappa(means: Doubles) -> Doubles:
    """Kappa (m,) of agreement averaged over codes; means (m, 1 + 2 codes): share of equal decisions, then of each code
    how often the first and how often the second coder gave it."""
    observed, (p, q) = means[:, 0], np.split(means[:, 1:], 2, axis=1)
    expected = (p * q + (1 - p) * (1 - q)).mean(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(expected < 1, (observed - expected) / (1 - expected), math.nan)
