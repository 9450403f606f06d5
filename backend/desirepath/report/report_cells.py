"""Numbers of a report as they stand in its tables and sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence

from desirepath.analysis.tested import Mean, Tested, p_in_words
from desirepath.report.findings import Findings

NONE = "–"


def significant_points(tests: Sequence[Tested], pairs: Sequence[Tested], found: Findings) -> list[Tested]:
    """What is said in a sentence: significant tests and pairs, and tests that could not have found anything."""
    alpha = found.plan.alpha
    said = [one for one in tests if one.significant(alpha) or not one.possible(alpha)]
    return [*said, *(one for one in pairs if one.significant(alpha))]


def statistic_cell(test: Tested) -> str:
    """`χ²(2) = 12.34`, `F(2, 24) = 1.10`."""
    if test.no_spread:
        return NONE
    inner = ", ".join(f"{df:.4g}" for df in (test.df, test.df_error) if df is not None)
    return f"{test.symbol}{f'({inner})' if inner else ''} = {test.statistic:.2f}"


def p_cells(test: Tested, alpha: float) -> list[str]:
    """p as it is and corrected, the latter with its stars, and how it was found; that without spread there is none."""
    if test.no_spread:
        return ["not testable", NONE, "no spread"]
    stars = f" {test.stars(alpha)}" if test.stars(alpha) else ""
    p = [p_in_words(test.p).removeprefix("p "), p_in_words(test.p_corrected).removeprefix("p ") + stars]
    return [*(one.removeprefix("= ") for one in p), test.method]


def effect_cell(test: Tested) -> str:
    """The effect with its 95 % interval, where there is one."""
    if math.isnan(test.effect):
        return NONE
    interval = "" if math.isnan(test.effect_low) else f" [{test.effect_low:.2f}, {test.effect_high:.2f}]"
    return f"{test.effect:.2f}{interval}"


def shift_cell(test: Tested) -> str:
    """The shift in the unit of the scale with its 95 % interval."""
    if test.shift is None:
        return NONE
    ends = (test.shift_low, test.shift_high)
    interval = "" if any(map(math.isinf, ends)) or any(map(math.isnan, ends)) else " [{:.2f}, {:.2f}]".format(*ends)
    return f"{test.shift:.2f}{interval}"


def name_in_words(name: str) -> str:
    """A key in words."""
    return name.replace("_", " ")


def pair_words(pair: tuple[str, str], between: str = " – ") -> str:
    """Two conditions in words."""
    return between.join(name.replace("_", " ") for name in pair)


def percent(value: float) -> str:
    """A share in percent."""
    return NONE if math.isnan(value) else f"{100 * value:.1f} %"


def share_words(mean: Mean) -> str:
    """A share with its interval, where there is one: one person has none."""
    if math.isnan(mean.low):
        return percent(mean.mean)
    return f"{percent(mean.mean)} ({percent(mean.low)} to {percent(mean.high)})"


def number_words(value: float, form: str) -> str:
    """A number that may not be known."""
    if math.isnan(value):
        return NONE
    text = form.format(value)
    return text.removeprefix("-") if not text.strip("-0.") else text  # no -0.00
