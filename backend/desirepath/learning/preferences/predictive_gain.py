"""How much the answer to a question is expected to tell about the answers to others: expected predictive information
gain (Bickford Smith et al. 2023), from probabilities that were drawn together. What is believed is
`free_posterior.py`'s. Pure.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]


def bits_about_others(asked: Doubles, others: Doubles) -> Doubles:
    """(n,) mutual information (bits) between the answer to each pair and the answer to one of m others, on average over
    these. asked (samples, n), others (samples, m): probability that the first is chosen, by each sample of what is
    believed."""
    both = asked.T @ others / len(asked)
    one, other = asked.mean(0)[:, None], others.mean(0)[None]
    common = (
        _part(both, one * other)
        + _part(one - both, one * (1 - other))
        + _part(other - both, (1 - one) * other)
        + _part(1 - one - other + both, (1 - one) * (1 - other))
    )
    found: Doubles = np.maximum(common.mean(1), 0.0)
    return found


def _part(joint: Doubles, apart: Doubles) -> Doubles:
    joint, apart = np.maximum(joint, 1e-12), np.maximum(apart, 1e-12)
    found: Doubles = joint * np.log2(joint / apart)
    return found
