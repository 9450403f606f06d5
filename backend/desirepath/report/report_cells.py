"""Estimates with their intervals, and tests, as they stand in a report's tables and sentences. Knows no findings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from desirepath.analysis.tested import Mean, Tested, p_in_words
from desirepath.explain.printed import Section, Table

NONE = "–"


def table_section(
    title: str, caption: str, heads: Sequence[str], rows: Sequence[Sequence[str]], *sentences: str
) -> Section:
    """A part of one table with what is said of it; empty where the table has no rows."""
    return Section(title, sentences, [Table(caption, heads, rows)]) if rows else Section(title)


def means_section(title: str, caption: str, means: Mapping[str, tuple[Mean, str]], *sentences: str) -> Section:
    """A part of means over people with their 95 % intervals, each in its own form."""
    rows = [
        [what, number_words(mean.mean, form), interval_cell(mean.low, mean.high, form), str(mean.n)]
        for what, (mean, form) in means.items()
    ]
    return table_section(title, caption, ["what", "mean", "95 %", "people"], rows, *sentences)


def significant_points(tests: Sequence[Tested], pairs: Sequence[Tested], alpha: float) -> list[str]:
    """A sentence for each significant test and pair, and for each test that could not have found anything."""
    reported = [test for test in tests if test.significant(alpha) or not test.possible(alpha)]
    return [test.sentence(alpha) for test in (*reported, *(pair for pair in pairs if pair.significant(alpha)))]


def test_row(test: Tested, alpha: float, columns: str) -> list[str]:
    """A test's cells; columns: their names, as below, with blanks between."""
    p, corrected, method = p_cells(test, alpha)
    cells = {
        "test": test.test,
        "about": test.about,
        "statistic": statistic_cell(test),
        "z": NONE if test.z is None else f"{test.z:.2f}",
        "p": p,
        "corrected": corrected,
        "method": method,
        "correction": test.correction,
        "effect": effect_cell(test),
        "named_effect": f"{test.effect_name} {effect_cell(test)}",
        "shift": shift_cell(test),
        "n": str(test.n),
        "used": str(test.used),
    }
    return [cells[name] for name in columns.split()]


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
    return [p_cell(test.p), f"{p_cell(test.p_corrected)} {test.stars(alpha)}".rstrip(), test.method]


def p_cell(p: float) -> str:
    """`0.012`, `< 0.001`."""
    return NONE if math.isnan(p) else p_in_words(p).removeprefix("p ").removeprefix("= ")


def effect_cell(test: Tested) -> str:
    """The effect with its 95 % interval, where there is one."""
    return NONE if math.isnan(test.effect) else f"{test.effect:.2f}{_brackets(test.effect_low, test.effect_high)}"


def shift_cell(test: Tested) -> str:
    """The shift in the unit of the scale with its 95 % interval."""
    return NONE if test.shift is None else f"{test.shift:.2f}{_brackets(test.shift_low, test.shift_high)}"


def _brackets(low: float, high: float) -> str:
    return f" [{low:.2f}, {high:.2f}]" if math.isfinite(low) and math.isfinite(high) else ""


def interval_cell(low: float, high: float, form: str = "{:.2f}") -> str:
    """`0.12 to 0.34`."""
    return f"{form.format(low)} to {form.format(high)}" if math.isfinite(low) and math.isfinite(high) else NONE


def name_in_words(name: str) -> str:
    """A key in words."""
    return name.replace("_", " ")


def pair_words(pair: tuple[str, str], between: str = " – ") -> str:
    """Two conditions in words."""
    return between.join(map(name_in_words, pair))


def percent(value: float) -> str:
    """A share in percent."""
    return NONE if math.isnan(value) else f"{100 * value:.1f} %"


def share_words(mean: Mean) -> str:
    """A share with its interval, where there is one: one person has none."""
    if math.isnan(mean.low):
        return percent(mean.mean)
    return f"{percent(mean.mean)} ({percent(mean.low)} to {percent(mean.high)})"


def number_words(value: float, form: str = "{:.2f}") -> str:
    """A number that may not be known."""
    if math.isnan(value):
        return NONE
    text = form.format(value)
    return text.removeprefix("-") if not text.strip("-0.") else text  # no -0.00


def plural(count: int, word: str) -> str:
    """The word as it follows that count."""
    return word if count == 1 else f"{word}s"
