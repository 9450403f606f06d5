"""The one way in which every chapter is reproduced: plan, compute what is missing, figures, results, card, report.

A chapter is a module `NAME/run.py` with a `CHAPTER`: its budgets, its tasks, and what it makes of them once they are
finished, beside what was printed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from desirepath.explain.printed import Section
from desirepath.learning.cards import Card, card_path, file_sha256
from desirepath_experiments.reproduction.chapter_report import REPORT, RESULTS, Fact, facts_of, write_report
from desirepath_experiments.reproduction.running import Tell, compute, write_results
from desirepath_experiments.reproduction.tasks import Function, Run, Task, TaskResult, Work

NAMES = ("enquery", "demonstrations", "interface", "adaptable", "depth", "pedestrians", "explanations")
ALWAYS_ANSWERED = ("budget", "seconds", "computed", "core_seconds", "commit")


@dataclass(frozen=True)
class Finished:
    """What a chapter makes its results of: a plan all of whose tasks are stored. figures: a folder for them."""

    plan: Any
    load: Callable[[str], TaskResult]
    run: Run
    figures: Path
    tell: Tell


@dataclass(frozen=True)
class Made:
    """What a chapter came to.

    results: what results.json holds besides the run; head: what the report's first lines say; more: of its template;
    facts: instead of the usual ones with those `further`; answer: what the command says besides `ALWAYS_ANSWERED`;
    files: figures that were drawn; card: the fields of a card (`Card`) that only the chapter knows.
    """

    results: Mapping[str, Any]
    head: Mapping[str, Any]
    sections: Sequence[Section]
    further: Sequence[Fact] = ()
    facts: Sequence[Fact] | None = None
    more: Mapping[str, Any] = field(default_factory=dict)
    answer: Mapping[str, Any] = field(default_factory=dict)
    files: Sequence[Path] = ()
    card: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Chapter:
    """A published chapter. plan: of a budget and the chapter's `options`, which have these values if nobody says, as
    `processes` has."""

    name: str
    budgets: Mapping[str, Any]
    functions: Mapping[str, Function]
    plan: Callable[..., Any]
    tasks: Callable[[Any], Sequence[Task]]
    make: Callable[[Finished], Made]
    task_name: Callable[[Task], str] = lambda task: task.kind.replace("_", " ")
    options: Mapping[str, Any] = field(default_factory=dict)
    processes: int = 2


def chapter_named(name: str) -> Chapter:
    """Raises LookupError for a chapter that is not reproduced."""
    if name not in NAMES:
        raise LookupError(f"chapter {name!r}: known are {', '.join(NAMES)}")
    chapter: Chapter = import_module(f"{__package__}.{name}.run").CHAPTER
    return chapter


def reproduce(
    chapter: Chapter,
    out: Path,
    budget: Any,
    *,
    processes: int | None = None,
    command: str = "",
    tell: Tell = lambda words: None,
    **options: Any,
) -> dict[str, Any]:
    """Compute what is missing under `out`/work, then write figures, results.json with its card, and report.html.

    Stopped in any way and started again, it goes on with the first task that is not stored. Raises RuntimeError if
    another run works in the same folder, LookupError for an option that the chapter has not, ValueError for a seed or
    number of processes that cannot be.
    """
    unknown = sorted(options.keys() - chapter.options.keys())
    if unknown:
        known = ", ".join(chapter.options) or "none"
        raise LookupError(f"{', '.join(unknown)}: not of chapter {chapter.name}, whose options are: {known}")
    plan = chapter.plan(budget, **{**chapter.options, **options})
    work = Work(out / "work")
    with work.claimed():
        run = compute(
            list(chapter.tasks(plan)),
            chapter.functions,
            work,
            command=command,
            processes=chapter.processes if processes is None else processes,
            tell=tell,
            name=chapter.task_name,
        )
        made = chapter.make(Finished(plan, work.load, run, out / "figures", tell))
        summary = write_results(out / RESULTS, run, budget, **made.results)
        if made.card is not None:
            _save_card(chapter, budget, run, out / RESULTS, made.card)
        facts = facts_of(run, *made.further) if made.facts is None else made.facts
        write_report(out, chapter.name, run, head=made.head, sections=made.sections, facts=facts, **made.more)
    answer = {key: summary[key] for key in ALWAYS_ANSWERED} | dict(made.answer)
    drawn = {"figures": [str(path) for path in made.files]} if made.files else {}
    return {"report": str(out / REPORT), "results": str(out / RESULTS), **drawn, **answer}


def _save_card(chapter: Chapter, budget: Any, run: Run, results: Path, fields: Mapping[str, Any]) -> None:
    """What the numbers were made of and how, beside them like every other artefact's card."""
    given = {"name": f"{chapter.name}/reproduce_{budget.name}", **fields}
    Card(
        kind="reproduction",
        file=results.name,
        sha256=file_sha256(results),
        command=run.command,
        commit=run.commit,
        **{**given, "results": {**given["results"], "core_seconds": run.core_seconds}},
    ).save(card_path(results))
