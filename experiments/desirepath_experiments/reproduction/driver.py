"""The one way in which every chapter is reproduced: plan, compute what is missing, figures, results, card, report.

A chapter is a package `NAME` whose `chapter.py` has a `CHAPTER`; its budgets stand in `budgets.yaml`, what was printed
in `published/NAME.yaml`, what its report says in `reports/NAME.yaml`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import yaml
from pydantic import ConfigDict, TypeAdapter

from desirepath.explain.printed import Shown, embed_picture
from desirepath.learning.cards import Card, card_path, file_sha256, short
from desirepath_experiments.reproduction.published import published
from desirepath_experiments.reproduction.reports import fill, report_of, sentences, write_compared, write_report
from desirepath_experiments.reproduction.tasks import Function, Load, Run, Task, Tell, Work, compute

if TYPE_CHECKING:
    from desirepath_experiments.reproduction.figures import Drawn

NAMES = ("enquery", "demonstrations", "interface", "adaptable", "depth", "pedestrians", "explanations")
ALWAYS_ANSWERED = ("budget", "seconds", "computed", "core_seconds", "commit")
REPORT, RESULTS, COMPARED = "report.html", "results.json", "compared.csv"
B = TypeVar("B")


@dataclass(frozen=True)
class Made:
    """What a chapter came to.

    results: what results.json holds besides the run, and the report names; more: what only the report names; answer:
    what the command says besides `ALWAYS_ANSWERED`; drawn: figures; card: the fields of a card (`Card`) that only the
    chapter knows, where its report has one.
    """

    results: Mapping[str, Any]
    more: Mapping[str, Any] = field(default_factory=dict)
    answer: Mapping[str, Any] = field(default_factory=dict)
    drawn: Sequence[Drawn] = ()
    card: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Chapter:
    """A published chapter. plan: of a budget and the chapter's `options`, which have these values if nobody says, as
    `processes` has: a dataclass that holds the budget and tasks. make: of a plan all of whose tasks are stored."""

    name: str
    budgets: Mapping[str, Any]
    functions: Mapping[str, Function]
    plan: Callable[..., Any]
    make: Callable[[Any, Load], Made]
    options: Mapping[str, Any] = field(default_factory=dict)
    processes: int = 2


def read_budgets(chapter: str, kind: type[B]) -> dict[str, B]:
    """A chapter's budgets by name. Raises ValueError for a file that says something else."""
    written = yaml.safe_load(Path(__file__).with_name("budgets.yaml").read_text(encoding="utf-8"))[chapter]
    named = {name: {"name": name, **settings} for name, settings in written.items()}
    read = TypeAdapter(dict[str, kind], config=ConfigDict(extra="forbid"))  # type: ignore[valid-type]
    return read.validate_json(json.dumps(named))


def chapter_named(name: str) -> Chapter:
    """Raises LookupError for a chapter that is not reproduced."""
    if name not in NAMES:
        raise LookupError(f"chapter {name!r}: known are {', '.join(NAMES)}")
    chapter: Chapter = import_module(f"{__package__}.{name}.chapter").CHAPTER
    return chapter


def tasks_in(plan: object) -> list[Task]:
    """All tasks that a plan holds, in its fields' order."""
    if isinstance(plan, Task):
        return [plan]
    if isinstance(plan, Mapping):
        return [task for part in plan.values() for task in tasks_in(part)]
    if isinstance(plan, list | tuple):
        return [task for part in plan for task in tasks_in(part)]
    return [task for part in fields(plan) for task in tasks_in(getattr(plan, part.name))] if is_dataclass(plan) else []


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
    processes = chapter.processes if processes is None else processes
    work = Work(out / "work")
    with work.claimed():
        run = compute(tasks_in(plan), chapter.functions, work, command=command, processes=processes, tell=tell)
        tell("drawing")
        outcome = chapter.make(plan, work.load)
        values = {"plan": plan, "budget": plan.budget, "run": run, "published": published(chapter.name)}
        values |= {**outcome.results, **outcome.more}
        files, shown = _save_figures(chapter.name, outcome.drawn, values, out / "figures")
        brief = sentences(report_of(chapter.name).brief, values)
        summary = write_results(
            out / RESULTS, run, plan.budget, {**outcome.results, **({"brief": brief} if brief else {})}
        )
        _save_card(chapter.name, out / RESULTS, outcome, values, brief)
        write_compared(out / COMPARED, chapter.name, values)
        write_report(out / REPORT, chapter.name, values, shown)
    answer = {key: summary[key] for key in ALWAYS_ANSWERED} | dict(outcome.answer) | ({"brief": brief} if brief else {})
    drawn = {"figures": files} if files else {}
    return {"report": str(out / REPORT), "results": str(out / RESULTS), **drawn, **answer}


def _save_figures(
    chapter: str, drawn: Sequence[Drawn], values: Mapping[str, Any], folder: Path
) -> tuple[list[str], list[Shown]]:
    """The files of all figures, and those that are shown in the report."""
    files, shown = [], []
    for figure in drawn:
        if not figure.rows:
            files.append(str(figure.save_alone(folder)))
            continue
        words, known = report_of(chapter).figures[figure.kind], {**values, **figure.about}
        picture = figure.picture(fill(words.title, known), fill(words.caption, known))
        files += [str(path) for path in picture.save(folder)]
        shown.append(embed_picture(picture, folder))
    return files, shown


def write_results(path: Path, run: Run, budget: Any, results: Mapping[str, Any]) -> dict[str, Any]:
    """Write results.json: run, budget, `results` and what is known of every task. Returns what stands in it."""
    of_run = ("processes", "seconds", "computed", "core_seconds")
    written: dict[str, Any] = {"command": run.command, "commit": run.commit, "budget": asdict(budget)}
    written |= {**{key: getattr(run, key) for key in of_run}, "simulated": True, **results, "tasks": run.made}
    path.write_text(json.dumps(short(plain(written)), indent=1) + "\n", encoding="utf-8")
    return written


def plain(value: Any) -> Any:
    """JSON has no NaN: null instead."""
    if isinstance(value, Mapping):
        return {key: plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _save_card(chapter: str, results: Path, outcome: Made, values: Mapping[str, Any], brief: list[str]) -> None:
    """What the numbers were made of and how, beside them like every other artefact's card, where the report has one."""
    report, budget, run = report_of(chapter), values["budget"], values["run"]
    if report.card is None:
        return
    words = report.card
    card = {
        "seed": budget.seeds[0] if hasattr(budget, "seeds") else values["seed"],
        "scenes": {name: fill(text, values) for name, text in words.scenes.items()},
        "departures": report.departures,
        "results": outcome.answer or {"brief": brief},
        **outcome.card,
    }
    card["results"] = {**card["results"], "core_seconds": run.core_seconds}
    Card(
        kind="reproduction",
        name=f"{words.name or chapter}/reproduce_{budget.name}",
        setup=fill(words.setup, values),
        notes=words.notes,
        file=results.name,
        sha256=file_sha256(results),
        command=run.command,
        commit=run.commit,
        **card,
    ).save(card_path(results))
