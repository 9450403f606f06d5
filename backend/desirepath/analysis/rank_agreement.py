"""How well rankings agree with scores: Kendall's tau-b, for many rankings at once. What is ranked is the reports'."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def kendall_tau_b(first: ArrayLike, second: ArrayLike) -> Array:
    """(n,) Kendall's tau-b of n pairs of rows, first (n, k) and second (n, k), ties corrected (Kendall 1945).

    nan where one of the two rows says no order at all. Raises ValueError for shapes that differ or fewer than two
    columns.
    """
    a, b = np.atleast_2d(np.asarray(first, dtype=float)), np.atleast_2d(np.asarray(second, dtype=float))
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] < 2:
        raise ValueError(f"first has shape {a.shape}, second {b.shape}; needs the same, at least two columns")
    i, j = np.triu_indices(a.shape[1], 1)
    one, other = np.sign(a[:, i] - a[:, j]), np.sign(b[:, i] - b[:, j])
    untied = (one != 0).sum(axis=1) * (other != 0).sum(axis=1)
    found: Array = np.where(untied > 0, (one * other).sum(axis=1) / np.sqrt(np.maximum(untied, 1)), np.nan)
    return found
