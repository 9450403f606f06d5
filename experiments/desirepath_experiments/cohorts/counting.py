"""Counting over many cohorts of simulated people what an analysis says of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable

from desirepath.report.simulated_power import Rate, rate

Said = Iterable[tuple[str, bool]]
"""Of one cohort: every statement that the analysis could make, and whether it makes it."""


def count(cohorts: int, said: Callable[[int], Said]) -> list[Rate]:
    """How often each statement was made. said: of the cohort with that number."""
    found, asked = Counter[str](), Counter[str]()
    for number in range(cohorts):
        for statement, made in said(number):
            asked[statement] += 1
            found[statement] += made
    return [rate(statement, found[statement], asked[statement]) for statement in asked]
