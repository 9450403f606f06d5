"""Chapter 2 as a report: bars met and missed, measures beside the baselines', what each part of the training gives."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from backend.demonstrations.judging import KINDS
from backend.demonstrations.td3_bc import DEPARTURES
from backend.explain.pictures import Picture
from backend.explain.printed import Section, Shown, Table, page, shown_picture
from backend.reproduction.demonstrations import CONTROLLERS, OURS, VARIANTS, Plan
from backend.reproduction.demonstrations_results import BARS, NAMES, SHOWN, Load, Row, measured
from backend.reproduction.enquery_report import kinds
from backend.reproduction.pieces import Run
from backend.reproduction.run import told_time

PREFERRED_M = "1.1 ± 0.2 m"  # section 2.6.3
WITHOUT = "no_demonstrations"


def write_report(path: Path, plan: Plan, rows: Sequence[Row], load: Load, drawn: Sequence[Picture], run: Run) -> None:
    """One HTML file with everything in it; figures are SVG."""
    html = page(
        __package__,
        "demonstrations.html",
        run={"budget": plan.budget.name, "seeds": ", ".join(map(str, plan.budget.seeds))},
        brief=brief(rows),
        sections=sections(plan, rows, load, drawn, path.parent / "figures"),
        facts=facts(plan, run),
        kinds=kinds(run),
    )
    path.write_text(html, encoding="utf-8")


def brief(rows: Sequence[Row]) -> list[str]:
    """The result in a few sentences, as the numbers have it."""
    ours = [row for row in rows if row.controller == OURS]
    told = []
    for name, bar in BARS.items():
        judged = [(row, bar.met(row.values[name])) for row in ours]
        known = [(row, met) for row, met in judged if met is not None]
        missed = [
            f"{row.style} in the {row.environment} ({_number(row.values[name])})" for row, met in known if not met
        ]
        relation = "at least" if bar.at_least else "at most"
        where = f"; missed: {', '.join(missed)}" if missed else ""
        told.append(
            f"{_capital(bar.name)}, {relation} {bar.bound}: met by {len(known) - len(missed)} of {len(known)} "
            f"controllers{where}."
        )
    plain = [row for row in rows if row.controller == WITHOUT]
    for row in plain:
        passes = BARS["frechet_m"].met(row.values["frechet_m"]) and BARS["t_star"].met(row.values["t_star"])
        told.append(
            f"TD3 without demonstrations ({row.style}): f = {_number(row.values['frechet_m'])} m at t* = "
            f"{_number(row.values['t_star'])}, so it {'passes' if passes else 'fails'} the bar on the Frechet distance"
            f"{', which is then worthless for this style' if passes else ''}."
        )
    return told


def sections(plan: Plan, rows: Sequence[Row], load: Load, drawn: Sequence[Picture], folder: Path) -> list[Section]:
    """The report's parts in order."""

    def shown(*beginnings: str) -> list[Shown]:
        return [shown_picture(one, folder) for one in drawn if one.name.startswith(beginnings)]

    main = [row for row in rows if row.controller in CONTROLLERS]
    ablated = [
        row
        for row in rows
        if (row.environment, row.style) in {(r.environment, r.style) for r in rows if r.controller == WITHOUT}
    ]
    return [
        Section("Demonstrations and drives", pictures=shown("paths")),
        Section(
            "Likeness to the demonstrations",
            [
                "Every controller drives once from every demonstrated start. f(t*) and t* are those of the "
                "demonstration of the same pair that is followed best; a small f at a small t* says nothing. Medians "
                "over drives, means over seeds; in brackets the worst seed."
            ],
            tables=[_bars_table(main)],
        ),
        Section(
            "Path length, distance, area",
            [f"The thesis's participants preferred a minimum human distance of {PREFERRED_M} in both environments."],
            tables=[_measures_table(plan, load)],
            pictures=shown("measures"),
        ),
        Section("Speed profiles", pictures=shown("speeds")),
        Section("Where nothing was demonstrated", tables=[_unseen_table(main)], pictures=shown("unseen")),
        Section(
            "What the parts of the training give",
            [
                "Without cloning: no behavioural-cloning term. Without goal boost: the goal earns nothing in the "
                "demonstrations either. TD3 without demonstrations: no demonstration buffer and no cloning; it is "
                "rewarded for reaching goals and for progress in exploration, as base policies are."
            ],
            tables=[_bars_table([row for row in ablated if row.controller in VARIANTS])],
            pictures=shown("curves"),
        ),
        Section("Where training departs from the thesis", points=DEPARTURES),
    ]


def facts(plan: Plan, run: Run) -> list[tuple[str, str]]:
    """Command, budgets, durations."""
    budget = plan.budget
    return [
        ("command", run.command),
        ("commit", run.commit),
        ("this run", f"{run.computed} pieces computed in {told_time(run.seconds)} by {run.processes} process(es)"),
        ("all pieces", f"{len(run.made)} pieces, {told_time(run.core_seconds)} of one core"),
        ("updates", f"{budget.updates:,} per controller"),
        (
            "demonstrations",
            f"{budget.per_pair} of each of four pairs, by {len(budget.styles)} programmed demonstrators",
        ),
        ("unseen scenes", f"{budget.unseen} of each of {', '.join(KINDS)}, per seed"),
    ]


def _bars_table(rows: Sequence[Row]) -> Table:
    heads = ["environment", "demonstrator", "controller", "seeds", *(bar.name for bar in BARS.values()), "CPU s"]
    return Table(
        "; ".join(f"{bar.name}: {'≥' if bar.at_least else '≤'} {bar.bound}" for bar in BARS.values()),
        heads,
        [
            [
                row.environment,
                row.style,
                NAMES[row.controller],
                str(row.seeds),
                *(_with_worst(row, name) for name in BARS),
                f"{row.cpu_s:.0f}" if row.cpu_s is not None else "-",
            ]
            for row in rows
        ],
    )


def _with_worst(row: Row, name: str) -> str:
    value = _number(row.values[name])
    return f"{value} ({_number(row.worst[name])})" if row.seeds > 1 else value


def _measures_table(plan: Plan, load: Load) -> Table:
    found = []
    for environment in plan.budget.environments:
        for style in plan.budget.styles:
            for controller in SHOWN:
                columns = [
                    measured(plan, load, environment, style, controller, name)
                    for name in ("relative_path_length", "min_human_distance", "path_area")
                ]
                told = [f"{np.mean(values):.2f} ± {np.std(values):.2f}" for values in columns]
                found.append([environment, style, NAMES[controller], str(len(columns[0])), *told])
    heads = [
        "environment",
        "demonstrator",
        "controller",
        "drives",
        "relative length",
        "human distance (m)",
        "area (m²)",
    ]
    return Table("Means ± standard deviations over drives from demonstrated starts", heads, found)


def _unseen_table(rows: Sequence[Row]) -> Table:
    heads = ["environment", "demonstrator", "controller", *(f"random {kind}" for kind in KINDS)]
    return Table(
        "Success rates, means over seeds; anywhere: start, goal and person",
        heads,
        [
            [row.environment, row.style, NAMES[row.controller], *(_number(row.values[kind]) for kind in KINDS)]
            for row in rows
        ],
    )


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]
