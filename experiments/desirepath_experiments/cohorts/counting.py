"""Counting over many cohorts of simulated people what an analysis says of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable

from desirepath.report.simulated_power import Rate, rate

Said = Iterable[tuple[str, bool]]
"""Of one cohort: every statement that the analysis could make, and whether it makes it."""


def count(cohorts: int, statements_of: Callable[[int], Said]) -> list[Rate]:
    """How often each statement was made. statements_of: of the cohort with that number."""
    made_counts, counts = Counter[str](), Counter[str]()
    for number in range(cohorts):
        for statement, was_made in statements_of(number):
            counts[statement] += 1
            made_counts[statement] += was_made
    return [rate(statement, made_counts[statement], counts[statement]) for statement in counts]
