"""What every chapter leaves behind besides its results: their card, its printed report, what its command says.

What was found, and the sections that tell it, are each chapter's own.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from desirepath.explain.printed import Section, page
from desirepath.learning.cards import Card, card_path, file_sha256
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


def save_card(
    out: Path,
    chapter: str,
    run: Run,
    budget: BudgetOfSeeds,
    *,
    setup: str,
    config: dict[str, Any],
    scenes: dict[str, Any],
    found: dict[str, Any],
    departures: list[str],
    note: str,
) -> None:
    """What the numbers were made of and how, beside them like every other artefact's card."""
    results = out / RESULTS
    Card(
        kind="reproduction",
        name=f"{chapter}/reproduce_{budget.name}",
        setup=setup,
        file=results.name,
        sha256=file_sha256(results),
        command=run.command,
        seed=budget.seeds[0],
        commit=run.commit,
        config=config,
        scenes=scenes,
        results={**found, "core_seconds": run.core_seconds},
        departures=departures,
        notes=[note],
    ).save(card_path(results))


def seeds_words(budget: BudgetOfSeeds) -> dict[str, str]:
    """Budget and seeds as a report's head names them."""
    return {"budget": budget.name, "seeds": ", ".join(map(str, budget.seeds))}


def said(
    out: Path, summary: Mapping[str, Any], keys: Sequence[str], figures: Sequence[Path] | None = None
) -> dict[str, Any]:
    """What the command answers with: where everything lies, and these parts of `summary`."""
    drawn = {} if figures is None else {"figures": [str(path) for path in figures]}
    where = {"report": str(out / REPORT), "results": str(out / RESULTS)}
    return {**where, **drawn, **{key: summary[key] for key in keys}}


def facts(run: Run, *more: Fact) -> list[Fact]:
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
