"""Every chapter's printed report. What was found, and the sections that tell it, are each chapter's own."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from desirepath.explain.printed import Section, page
from desirepath_experiments.reproduction.running import time_in_words
from desirepath_experiments.reproduction.tasks import Run

REPORT, RESULTS = "report.html", "results.json"
Fact = tuple[str, str]


class BudgetOfSeeds(Protocol):
    """A budget whose tasks are computed with several seeds."""

    @property
    def name(self) -> str: ...
    @property
    def seeds(self) -> Sequence[int]: ...


def write_report(
    out: Path,
    chapter: str,
    run: Run,
    head: Mapping[str, Any],
    sections: Sequence[Section],
    facts: Sequence[Fact],
    **more: Any,
) -> None:
    """One HTML file with everything in it; figures are SVG. head: what the template's first lines say of the run."""
    html = page(__package__, f"{chapter}.html", run=head, sections=sections, facts=facts, kinds=kinds(run), **more)
    (out / REPORT).write_text(html, encoding="utf-8")


def seeds_words(budget: BudgetOfSeeds) -> dict[str, str]:
    """Budget and seeds as a report's head names them."""
    return {"budget": budget.name, "seeds": ", ".join(map(str, budget.seeds))}


def facts_of(run: Run, *more: Fact) -> list[Fact]:
    """Command, commit, durations; then the chapter's own."""
    return [
        ("Command", run.command),
        ("Commit", run.commit),
        ("Time", f"{time_in_words(run.seconds)} with {run.processes} processes"),
        ("Work", f"{len(run.made)} tasks, {time_in_words(run.core_seconds)} of one core"),
        *more,
    ]


def kinds(run: Run) -> list[dict[str, Any]]:
    """Tasks, seconds and commits by kind of work."""
    grouped: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
    for key, about in run.made.items():
        grouped[key.rpartition("-")[0]].append(about)
    return [
        {
            "kind": kind.replace("_", " "),
            "tasks": len(abouts),
            "seconds": f"{sum(float(about['seconds']) for about in abouts):.0f}",
            "cpu_seconds": f"{sum(float(about['cpu_seconds']) for about in abouts):.0f}",
            "commits": ", ".join(sorted({_short(str(about["commit"])) for about in abouts})),
        }
        for kind, abouts in grouped.items()
    ]


def _short(commit: str) -> str:
    name, _, dirty = commit.partition("-")
    return f"{name[:10]}{'-' + dirty if dirty else ''}"
