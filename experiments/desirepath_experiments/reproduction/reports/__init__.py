"""Every chapter's report: sections, tables, figures and sentences as `NAME.yaml` declares them, filled with numbers.

What was found is the chapters' own; a text is a Jinja template of it, and one that comes to nothing is left out. A loop
is written as Python's: `name, row in rows.items()`.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup
from pydantic import Field

from desirepath.analysis.tested import p_in_words
from desirepath.csv_text import csv_text
from desirepath.explain.printed import Section, Shown, Table, page
from desirepath.grammar.error_words import parse
from desirepath.grammar.parts import Part
from desirepath.grammar.source import Source, file_text
from desirepath_experiments.reproduction.published import published
from desirepath_experiments.reproduction.tasks import Run, time_in_words

Values = Mapping[str, Any]


def formatted(value: float | str | None, spec: str = ".3g", missing: str = "-") -> str:
    """A number by Python's format; a text as it is; `missing` for None and NaN."""
    if isinstance(value, str):
        return value
    return missing if value is None or math.isnan(value) else format(value, spec)


def beside(reproduced: float | None, printed: float | str | None, spec: str = ".3g") -> str:
    """Ours with what was printed in brackets."""
    return f"{formatted(reproduced, spec)} ({formatted(printed, '')})"


def with_spread(measure: Values, spec: str) -> str:
    """A mean over seeds with the difference between the best and the worst in brackets."""
    seeds = measure.get("seeds", [measure["mean"]])
    return f"{formatted(measure['mean'], spec)} ({formatted(max(seeds) - min(seeds), spec)})"


def with_interval(mean: Any) -> str:
    """A share with half the width of its interval (`accuracy`, `low`, `high`), in percent; a dash for None."""
    if mean is None:
        return "–"
    half = "" if math.isnan(mean.low) else f" ± {50 * (mean.high - mean.low):.0f}"
    return f"{100 * mean.accuracy:.0f}{half}"


_TEXTS = jinja2.Environment(undefined=jinja2.StrictUndefined, autoescape=False)  # noqa: S701 - the page escapes
_TEXTS.filters |= {
    "f": formatted,
    "beside": beside,
    "spread": with_spread,
    "accuracy": with_interval,
    "rates": lambda of: " / ".join(
        f"{100 * of[rate]:.0f}" for rate in ("success_rate", "collision_rate", "timeout_rate")
    ),
    "share": lambda value: f"{100 * value:.0f} %",
    "percent": lambda value: f"{100 * value:.1f} %",
    "yes": lambda value: "yes" if value else "no",
    "words": lambda name: name.replace("_", " "),
    "time": time_in_words,
    "p": p_in_words,
    "upper_first": lambda text: text[:1].upper() + text[1:],
}
_TEXTS.globals["new"] = "\n"
_template = cache(_TEXTS.from_string)
_expression = cache(lambda source: _TEXTS.compile_expression(source, undefined_to_none=False))


class TableWords(Part):
    """rows, each: loops, of rows and of such tables. columns: head and cell, and a loop where it is several columns."""

    caption: str
    each: str = ""
    rows: str
    columns: list[list[str]]


class SectionWords(Part):
    """figures: beginnings of the names of those that are shown. when: only where this expression is true."""

    title: str
    when: str = "true"
    text: list[str] = Field(default_factory=list)
    tables: list[TableWords] = Field(default_factory=list)
    points: list[str] = Field(default_factory=list)
    figures: list[str] = Field(default_factory=list)


class FigureWords(Part):
    title: str
    caption: str


class CardWords(Part):
    """What a card says besides settings and results."""

    name: str = ""
    setup: str
    scenes: dict[str, str]
    notes: list[str]


class Report(Part):
    """note: of what is simulated, may be HTML. small: what is said of the small budget. facts: how it was made."""

    title: str
    note: str
    brief: list[str] = Field(default_factory=list)
    small: str = ""
    facts: dict[str, str] = Field(default_factory=dict)
    sections: list[SectionWords]
    figures: dict[str, FigureWords] = Field(default_factory=dict)
    departures: list[str] = Field(default_factory=list)
    card: CardWords | None = None


@cache
def report_of(chapter: str) -> Report:
    """Raises ProtocolError for a file that says something else."""
    path = Path(__file__).with_name(f"{chapter}.yaml")
    return parse(Source(path.name, file_text(path)), Report)


def fill(text: str, values: Values) -> str:
    """A text with its numbers, on one line."""
    return " ".join(_template(text).render(values).split())


def sentences(texts: list[str], values: Values) -> list[str]:
    """Those that come to something; `{{ new }}` within one begins another."""
    filled = (line for text in texts for line in _template(text).render(values).split("\n"))
    return [" ".join(line.split()) for line in filled if line.strip()]


def _loop(clause: str, values: Values) -> Iterator[dict[str, Any]]:
    """The values once for each turn of a loop; once where there is none."""
    if not clause:
        yield dict(values)
        return
    names, _, source = clause.partition(" in ")
    targets = [name.strip() for name in names.split(",")]
    for item in _expression(source)(values) or ():
        yield {**values, **dict(zip(targets, item if len(targets) > 1 else [item], strict=True))}


def _table(words: TableWords, values: Values) -> Table:
    def columns(of: Values, part: int) -> list[str]:
        return [
            fill(column[part], turn)
            for column in words.columns
            for turn in _loop(column[2] if len(column) > 2 else "", of)
        ]

    rows = [columns(row, 1) for row in _loop(words.rows, values)]
    return Table(fill(words.caption, values), columns(values, 0), rows)


def sections_of(report: Report, values: Values, shown: list[Shown]) -> list[Section]:
    return [
        Section(
            fill(words.title, values),
            sentences(words.text, values),
            [_table(table, turn) for table in words.tables for turn in _loop(table.each, values)],
            sentences(words.points, values),
            [figure for figure in shown if figure["name"].startswith(tuple(words.figures))],
        )
        for words in report.sections
        if _expression(words.when)(values)
    ]


def write_report(path: Path, chapter: str, values: Values, shown: list[Shown]) -> None:
    """One HTML file with everything in it; figures are SVG."""
    report, run = report_of(chapter), values["run"]
    values = {"departures": report.departures, **values}
    html = page(
        __package__,
        "chapter.html",
        title=report.title,
        note=Markup(fill(report.note, values)),  # noqa: S704 - the report's own words and numbers
        brief=sentences(report.brief, values),
        small=Markup(report.small if values["budget"].name == "small" else ""),  # noqa: S704
        sections=sections_of(report, values, shown),
        facts=_facts(run) | {name: fill(text, values) for name, text in report.facts.items()},
        kinds=_kinds(run),
    )
    path.write_text(html, encoding="utf-8")


def write_compared(path: Path, chapter: str, values: Values) -> None:
    """Every printed number with ours beside it, one a row."""
    rows: list[list[object]] = [["table", "condition", "measure", "unit", "printed", "here", "compared", "met"]]
    for name, table in published(chapter).tables.items():
        for condition, printed in table.rows.items():
            for measure, number in printed.items():
                reproduced = _expression(table.ours)(**values, condition=condition, measure=measure)
                reproduced = None if reproduced != reproduced else reproduced  # NaN is not itself
                compared = table.compared.get(condition, {}).get(measure, "")
                met = ""
                if compared and reproduced is not None:
                    met = "yes" if (reproduced >= number if compared == "at least" else reproduced <= number) else "no"
                rows.append([name, condition, measure, table.units[measure], number, reproduced, compared, met])
    path.write_text(csv_text(rows), newline="\r\n", encoding="utf-8")


def _facts(run: Run) -> dict[str, str]:
    return {
        "Command": run.command,
        "Commit": run.commit,
        "This run": f"{run.computed} tasks computed in {time_in_words(run.seconds)} by {run.processes} process(es)",
        "All tasks": f"{len(run.made)} tasks, {time_in_words(run.core_seconds)} of one core",
    }


def _kinds(run: Run) -> list[dict[str, str | int]]:
    """Tasks, seconds and commits by kind of work."""
    grouped: dict[str, list[Values]] = defaultdict(list)
    for key, about in run.made.items():
        grouped[key.rpartition("-")[0]].append(about)
    return [
        {
            "kind": kind.replace("_", " "),
            "tasks": len(abouts),
            **{name: f"{sum(float(about[name]) for about in abouts):.0f}" for name in ("seconds", "cpu_seconds")},
            "commits": ", ".join(sorted({_short(str(about["commit"])) for about in abouts})),
        }
        for kind, abouts in grouped.items()
    ]


def _short(commit: str) -> str:
    name, _, dirty = commit.partition("-")
    return f"{name[:10]}{'-' + dirty if dirty else ''}"
