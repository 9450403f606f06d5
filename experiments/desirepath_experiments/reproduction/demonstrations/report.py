"""Chapter 2 as a report: bars met and missed, measures beside the baselines', what each part of the training gives."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from desirepath.demonstrations.controllers import BASELINES
from desirepath.demonstrations.judging import KINDS
from desirepath.demonstrations.td3_bc.configuration import DEPARTURES
from desirepath.explain.pictures import Picture
from desirepath.explain.printed import Section, Shown, Table, embed_picture
from desirepath_experiments.reproduction.demonstrations.plan import (
    CONTROLLERS,
    OURS,
    VARIANTS,
    WITHOUT,
    DemonstrationsPlan,
)
from desirepath_experiments.reproduction.demonstrations.results import (
    BARS,
    MEASURES,
    NAMES,
    SHOWN,
    ControllerRow,
    Load,
    measured,
)
from desirepath_experiments.reproduction.running import time_in_words
from desirepath_experiments.reproduction.tasks import Run

PREFERRED_M = "1.1 ± 0.2 m"  # section 2.6.3
_ABLATED = (
    "Without cloning: no behavioural-cloning term. Without goal boost: the goal earns no more in the demonstrations "
    "than in exploration."
)
_CONTROL = (
    "TD3 without demonstrations: no demonstration buffer and no cloning; it is rewarded for reaching goals and for "
    "progress in exploration, as base policies are."
)
_UNCONTROLLED = "Only the whole training was run; the budget `full` also leaves out its parts."


def brief(plan: DemonstrationsPlan, rows: Sequence[ControllerRow], load: Load) -> list[str]:
    """The result in a few sentences, as the numbers have it."""
    ours = [row for row in rows if row.controller == OURS]
    sentences = []
    for name, bar in BARS.items():
        judged = [(row, bar.met(row.values[name])) for row in ours]
        known = [(row, met) for row, met in judged if met is not None]
        missed = [f"{_whose(row)} ({_number(row.values[name])})" for row, met in known if not met]
        relation = "at least" if bar.at_least else "at most"
        where = f"; missed: {', '.join(missed)}" if missed else ""
        sentences.append(
            f"{_capital(bar.name)}, {relation} {bar.bound}: met by {len(known) - len(missed)} of {len(known)} "
            f"controllers, means over seeds{where}."
        )
    return [*sentences, *_trained_in(ours), *_without(rows), *_measures_brief(plan, load)]


def _trained_in(ours: Sequence[ControllerRow]) -> list[str]:
    """How long training took."""
    spent = [row.cpu_s for row in ours if row.cpu_s is not None]
    ready = [row.ready_s for row in ours]
    known = [s for s in ready if s is not None]
    slowest = f", the slowest seed after {max(known):.0f} s" if known else ""
    return [
        f"Training took {np.mean(spent):.0f} CPU seconds of one core ({min(spent):.0f}-{max(spent):.0f}), measuring "
        f"every checkpoint included. {len(known)} of {len(ready)} controllers meet the bars on demonstrated starts "
        f"at some checkpoint with every seed{slowest}."
    ]


def _without(rows: Sequence[ControllerRow]) -> list[str]:
    """Whether the bar on the Frechet distance says anything: who has seen no demonstrations must miss it."""
    plain = [row for row in rows if row.controller == WITHOUT]
    if not plain:
        return []
    passing = [
        f"{_whose(row)} (f = {_number(row.values['frechet_m'])} m at t* = {_number(row.values['t_star'])}, "
        f"{100 * (row.values['followed_rate'] or 0):.0f} % of rollouts follow)"
        for row in plain
        if row.follows
    ]
    worthless = f"; it passes for {', '.join(passing)}, of whose paths the bar then says nothing" if passing else ""
    return [
        f"TD3 without demonstrations, which must miss the bar on the Frechet distance: it misses it for "
        f"{len(plain) - len(passing)} of {len(plain)} demonstrators{worthless}."
    ]


def _measures_brief(plan: DemonstrationsPlan, load: Load) -> list[str]:
    """What the thesis says of ours beside the two baselines, counted."""
    sentences = []
    for name, title in MEASURES.items():
        compared = [
            {c: float(np.mean(measured(plan, load, environment, style, c, name))) for c in CONTROLLERS}
            for environment in plan.budget.environments
            for style in plan.budget.styles
        ]
        beaten = {b: sum(means[OURS] > means[b] for means in compared) for b in BASELINES}
        sentences.append(f"{title} above {' and '.join(f'that of {NAMES[b]} in {n}' for b, n in beaten.items())}")
    cases = len(plan.budget.environments) * len(plan.budget.styles)
    return [
        f"Ours beside the baselines, means over rollouts, of {cases} demonstrators and environments: "
        f"{'; '.join(sentences)}."
    ]


def _whose(row: ControllerRow) -> str:
    return f"{row.style.replace('_', ' ')} in the {row.environment}"


def sections(
    plan: DemonstrationsPlan, rows: Sequence[ControllerRow], load: Load, drawn: Sequence[Picture], folder: Path
) -> list[Section]:
    """The report's parts in order."""

    def shown(*beginnings: str) -> list[Shown]:
        return [embed_picture(one, folder) for one in drawn if one.name.startswith(beginnings)]

    main = [row for row in rows if row.controller in (*CONTROLLERS, WITHOUT)]
    whole = (plan.budget.environments[0], plan.budget.ablated)
    ablated = [row for row in rows if (row.environment, row.style) == whole and row.controller in VARIANTS]
    return [
        Section("Demonstrations and rollouts", pictures=shown("paths")),
        Section(
            "Likeness to the demonstrations",
            [
                "Every controller rolls out once from every demonstrated start. f(t*) and t* are those of the "
                "demonstration of the same pair that is followed best; a small f at a small t* says nothing. Two "
                "medians may come from different rollouts, and a robot that circles where it starts has a small f at "
                "t* = 1: so the share of them is given that arrive with f at most 0.25 m and t* at least 0.8. "
                "Medians over rollouts, means over seeds; in brackets the worst seed. TD3 without demonstrations is a "
                "controller per environment and seed, one for all demonstrators."
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
            [_ABLATED, _CONTROL] if plan.budget.controls else [_UNCONTROLLED],
            tables=[_bars_table(ablated)],
            pictures=shown("curves"),
        ),
        Section("Where training departs from the thesis", points=DEPARTURES),
    ]


def facts(plan: DemonstrationsPlan, run: Run) -> list[tuple[str, str]]:
    """Command, budgets, durations."""
    budget = plan.budget
    return [
        ("command", run.command),
        ("commit", run.commit),
        ("this run", f"{run.computed} tasks computed in {time_in_words(run.seconds)} by {run.processes} process(es)"),
        ("all tasks", f"{len(run.made)} tasks, {time_in_words(run.core_seconds)} of one core"),
        ("updates", f"{budget.updates:,} per controller"),
        (
            "demonstrations",
            f"{budget.per_pair} of each of four pairs, by {len(budget.styles)} programmed demonstrators",
        ),
        ("unseen scenes", f"{budget.unseen} of each of {', '.join(KINDS)}, per seed"),
    ]


def _bars_table(rows: Sequence[ControllerRow]) -> Table:
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


def _with_worst(row: ControllerRow, name: str) -> str:
    value = _number(row.values[name])
    return f"{value} ({_number(row.worst[name])})" if row.seeds > 1 else value


def _measures_table(plan: DemonstrationsPlan, load: Load) -> Table:
    found = []
    for environment in plan.budget.environments:
        for style in plan.budget.styles:
            for controller in SHOWN:
                columns = [
                    measured(plan, load, environment, style, controller, name)
                    for name in ("relative_path_length", "min_human_distance", "path_area")
                ]
                cells = [f"{np.mean(values):.2f} ± {np.std(values):.2f}" for values in columns]
                found.append([environment, style, NAMES[controller], str(len(columns[0])), *cells])
    heads = [
        "environment",
        "demonstrator",
        "controller",
        "rollouts",
        "relative length",
        "human distance (m)",
        "area (m²)",
    ]
    return Table("Means ± standard deviations over rollouts from demonstrated starts", heads, found)


def _unseen_table(rows: Sequence[ControllerRow]) -> Table:
    heads = ["environment", "demonstrator", "controller", *(f"random {kind}" for kind in KINDS)]
    return Table(
        "Success rates, means over seeds (worst seed); anywhere: start, goal and person",
        heads,
        [
            [row.environment, row.style, NAMES[row.controller], *(_with_worst(row, kind) for kind in KINDS)]
            for row in rows
        ],
    )


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]
