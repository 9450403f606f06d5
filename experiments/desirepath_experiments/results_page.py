"""The manual's page of results, `docs/results.md`: every number is read from a stored result, none is typed."""

from __future__ import annotations

import csv
import gzip
import json
import re
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from desirepath.analysis.estimates import wilson
from desirepath.installed import ROOT

STORED = ROOT / "experiments" / "results"
FEW = 8
"""Of fewer units no interval is resampled: the lowest and the highest are told."""
INTRO = """# Results

Written by `make results` from `experiments/results`. Every participant is simulated. Each row is one number: the
**median** over the units that the last column names (preferences, people, seeds), with the worst of them beside it; a
share of trials that worked has no median and stands as it is. Intervals are of 95 %: of medians resampled over the
units, of shares Wilson's; of fewer than eight units the lowest and the highest are given. What was tried, and all else
that was measured: `experiments/notebook`. What falls short: [limits](limits.md).
"""


@dataclass(frozen=True)
class Stored:
    """A result file below `experiments/results`."""

    file: str
    data: Any

    def __getitem__(self, key: str) -> Any:
        return self.data[key]

    @property
    def command(self) -> str:
        """As it was stored, without the file it wrote."""
        return re.sub(r" --(?:out|keep) (?!DIR\b)\S+| --(?:json|at-once)\b", "", str(self["command"]))


@dataclass(frozen=True)
class Result:
    """One number of the page. over: what was measured, and how often."""

    what: str
    number: str
    interval: str
    worst: str
    over: str
    stored: Stored


Shown = Callable[[float], str]


def percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def percent_exactly(share: float) -> str:
    return f"{100 * share:.1f} %"


def metres(length: float) -> str:
    return f"{length:.2f} m"


def seconds(time: float) -> str:
    return f"{time:.1f} s"


def _between(low: str, high: str) -> str:
    """Two numbers in one unit, which is said once."""
    return f"{low.partition(' ')[0]} to {high}"


def _read(file: str) -> Stored:
    content = (STORED / file).read_bytes()
    return Stored(file, json.loads(gzip.decompress(content) if file.endswith(".gz") else content))


def _rows(file: str) -> list[dict[str, str]]:
    content = (STORED / file).read_bytes()
    text = (gzip.decompress(content) if file.endswith(".gz") else content).decode()
    return list(csv.DictReader(text.splitlines()))


def _median(
    what: str, units: Mapping[str, Sequence[float]], shown: Shown, over: str, stored: Stored, most: bool = False
) -> Result:
    """The median over all runs of all units. units: runs by unit. most: the highest is the worst."""
    runs = np.concatenate([np.asarray(each, dtype=float) for each in units.values()])
    medians = {unit: float(np.median(each)) for unit, each in units.items()}
    worst = (max if most else min)(medians, key=lambda unit: medians[unit])
    if len(units) < FEW:
        interval = _between(shown(runs.min()), shown(runs.max()))
    else:
        drawn = np.random.default_rng(0).integers(len(units), size=(2_000, len(units)))
        of = [np.asarray(each, dtype=float) for each in units.values()]
        low, high = np.quantile([np.median(np.concatenate([of[k] for k in row])) for row in drawn], [0.025, 0.975])
        interval = _between(shown(low), shown(high))
    told = f"{shown(medians[worst])} ({worst})" if len(units) < FEW or not worst.isdigit() else shown(medians[worst])
    return Result(what, shown(float(np.median(runs))), interval, told, over, stored)


def _share(what: str, right: int, n: int, worst: str, over: str, stored: Stored) -> Result:
    estimate = wilson(right, n)
    interval = _between(percent_exactly(estimate.low), percent_exactly(estimate.high))
    return Result(what, percent_exactly(estimate.value), interval, worst, over, stored)


def _by(rows: Sequence[Mapping[str, str]], unit: str, value: str) -> dict[str, list[float]]:
    """Values of the rows by unit, without those that have none."""
    found = defaultdict[str, list[float]](list)
    for row in rows:
        if row[value]:
            found[row[unit]].append(float(row[value]))
    return found


def _headline(setup: str, name: str) -> Result:
    stored = _read(f"{setup}/headline.json")
    rows = [row for row in _rows(f"{setup}/headline.rows.csv") if float(row["lapse_rate"]) == 0]
    over = f"{len(stored['config']['preferences'])} preferences, seeds {_from_to(stored['config']['seeds'])}"
    what = f"What 15 answers are worth in the {name}: base policy 0 %, planned rollouts 100 %"
    return _median(what, _by(rows, "preference", "share"), percent, over, stored)


def _from_to(seeds: Sequence[int]) -> str:
    return f"{min(seeds)} to {max(seeds)}"


AT_ONCE, BEHIND = "study_room/people_at_once", "study_room/people"
"""Runs with people: of what is there at once; of a policy trained behind it, which takes longer to measure."""


def _people_predicted() -> Result:
    stored = _read(f"{AT_ONCE}.json")
    rows = _rows(f"{AT_ONCE}.persons.csv.gz")
    answers = max(stored["config"]["answers"])
    units = {f"{row['person']}": [float(row[f"predicted.{answers}"])] for row in rows}
    told = _rows(f"{AT_ONCE}.predicted.csv")
    of_all = next(row for row in told if (row["family"], row["answers"]) == ("all", str(answers)))
    what = (
        f"Answers to fresh pairs predicted after {answers} right ones; calibration error "
        f"{percent_exactly(float(of_all['calibration_error']))}"
    )
    return _median(what, units, percent, _over_people(AT_ONCE), stored)


def _people_shown(run: str, way: str, what: str) -> Result:
    of = _of_way(run, way)
    gain, better = of["all"]["gain_of_shown"], of["all"]["better_of_shown"]
    what = (
        f"{what}. Their gain, in typical differences of a pair: "
        f"median {gain[0]:.2f}, {_between(f'{gain[1]:.2f}', f'{gain[2]:.2f}')}; truly better off: "
        f"{percent_exactly(better[0])}, {_between(percent_exactly(better[1]), percent_exactly(better[2]))}"
    )
    return _rate_of_way(run, what, "shown", of)


def _people_harmed(run: str, way: str, what: str) -> Result:
    return _rate_of_way(run, what, "harmed", _of_way(run, way))


def _of_way(run: str, way: str) -> dict[str, dict[str, Any]]:
    """Its rows, by family: estimates with their intervals."""
    rows = [row for row in _rows(f"{run}.ways.csv") if row["way"] == way]
    return {
        row["family"]: {key: json.loads(row[key] or "null") for key in row.keys() - {"family", "way"}} for row in rows
    }


def _rate_of_way(run: str, what: str, rate: str, of: Mapping[str, dict[str, Any]]) -> Result:
    everybody = of["all"]
    families = {name: row[rate][0] for name, row in of.items() if name != "all"}
    worst = max(families, key=lambda name: families[name] * (1 if rate == "harmed" else -1))
    told = f"{percent_exactly(families[worst])} ({worst})"
    n = everybody["people"]
    return _share(what, round(everybody[rate][0] * n), n, told, _over_people(run), _read(f"{run}.json"))


def _over_people(run: str) -> str:
    rows = _rows(f"{run}.predicted.csv")
    families = len({row["family"] for row in rows}) - 1
    return f"{rows[0]['people']} people of {families} families; nothing was tuned on these people"


def _words() -> Result:
    stored = _read("words/test.json")
    found = {language: stored["found"][language]["foremost"] for language in ("en", "de", "both")}
    worst = min(("en", "de"), key=lambda language: found[language]["value"])
    over = f"{found['both']['n']} sentences that say a foremost wish"
    what = "Wishes in plain words: the foremost objective is the one that was meant"
    return _share(
        what,
        found["both"]["right"],
        found["both"]["n"],
        f"{percent_exactly(found[worst]['value'])} ({worst})",
        over,
        stored,
    )


def _training() -> Result:
    stored, before = _read("open_field/benchmark_curves.json"), _read("open_field/benchmark_train_guided.json")
    units = {f"seed {seed}": [reached] for seed, reached in enumerate(stored["seconds_to_99"], stored["first_seed"])}
    alone, theirs = (before["seconds_to_94_per_arm"][arm] for arm in ("unguided", "sb3_fast"))
    what = (
        "Processor time of a base policy, which imitates a planner, until it arrives in 99 % of fresh scenes (94 %: "
        f"{seconds(stored['median']['94'])}; TD3 without a planner to 94 %: {seconds(alone)}, Stable-Baselines3's: "
        f"{seconds(theirs)})"
    )
    return _median(what, units, seconds, f"{len(units)} seeds", stored, most=True)


def _engine() -> Result:
    stored = _read("study_room/benchmark_simulate.json")
    number = f"{stored['ratio']:,.0f} times"
    command = f"desirepath benchmark simulate --setup {stored['setup']} --seed {stored['seed']}"
    what = "Steps per second of the fast engine beside PyBullet with wheel motors"
    return Result(what, number, "-", "-", "one run", Stored(stored.file, {"command": command}))


def _serving() -> Result:
    stored = _read("study_room/benchmark_serve_50.json")
    result = stored["result"]
    aligning = result["during_alignment"]
    over = f"{result['sessions']} participants at once, {result['answers_sent']} answers, {result['cores']} cores"
    what = f"An answer acknowledged ({result['answers_stored']} of {result['answers_sent']} stored), median"
    worst = f"{result['max_ack_ms']:.0f} ms; {aligning['max_ack_ms']:.0f} ms while a policy is aligned"
    number, most = f"{result['p50_ack_ms']:.0f} ms", f"95 % within {result['p95_ack_ms']:.0f} ms"
    return Result(what, number, most, worst, over, stored)


def _false_findings() -> Result:
    stored = _read("study_room/null_cohorts.json")
    rates = {row["test"]: row for row in _rows("study_room/null_cohorts.rates.csv")}
    row = rates["Friedman, any item, corrected"]
    corrected = [float(one["rate"]) for name, one in rates.items() if "corrected" in name]
    over = f"{stored['cohorts']:,} studies of {stored['participants']} people in which nothing differs"
    what = "Interface studies that find a difference where there is none (aim: at most 5 %)"
    worst = f"{percent_exactly(max(corrected))} (any corrected family)"
    return _share(what, int(row["found"]), int(row["n"]), worst, over, stored)


def _robot() -> Result:
    stored = _read("study_room/benchmark_robot.json")
    right, n = round(stored["robot_success"] * stored["scenes"]), stored["scenes"]
    what = f"Arrives over ROS 2, in others' simulator (in ours: {percent_exactly(stored['engine_success'])})"
    return _share(what, right, n, "-", f"{n} scenes, seed {stored['seed']}", stored)


def _demonstrations() -> Result:
    stored = _read("demonstrations/reproduce_full/results.json.gz")
    units = {
        f"{row['style']} in the {row['environment']}".replace("_", " "): [row["values"]["anywhere"]]
        for row in stored["rows"]
        if row["controller"] == "ours"
    }
    over = f"{len(units)} demonstrators and places, seeds {_from_to(stored['budget']['seeds'])}"
    what = "Chapter 2: controllers from 16 drawn paths arrive with start, goal and person random"
    return _median(what, units, percent, over, stored)


def _depth() -> Result:
    stored = _read("home/reproduce_depth_small.json.gz")
    seeds = stored["configurations"]["VAE-HA"]["seeds"]
    units = {f"seed {k}": [one["unseen"]["success_rate"]] for k, one in enumerate(seeds)}
    over = f"{len(units)} seeds, {seeds[0]['unseen']['n']} episodes each"
    what = "Chapter 3: the depth controller VAE-HA arrives in homes never seen (bar: 90 %)"
    return _median(what, units, percent, over, stored)


def _pedestrians() -> Result:
    stored = _read("crowd_corridor/reproduce_small/results.json.gz")
    rates = stored["rates"]["ours"]["published"]["success"]["seeds"]
    units = {f"seed {seed}": [rate / 100] for seed, rate in zip(stored["budget"]["seeds"], rates, strict=True)}
    over = f"{len(units)} seeds, {stored['budget']['episodes']:,} scenes each"
    what = "Chapter 4: arrives among pedestrians in the published setting, by imitation (printed: 86.2 %)"
    return _median(what, units, percent_exactly, over, stored)


def _adaptable() -> Result:
    stored = _read("adaptable/reproduce_full/results.json")
    units = {f"seed {seed}": [one["success"] / 100] for seed, one in stored["table"]["ours"]["seeds"].items()}
    what = "Chapter 5: one policy arrives under 33 weightings of three objectives"
    return _median(what, units, percent_exactly, f"{len(units)} seeds", stored)


def _enquery() -> Result:
    stored = _read("open_field/reproduce_medium/results.json.gz")
    (row,) = [one for one in stored["results"]["tables"]["thesis"] if one["name"] == "EnQ-15"]
    units = {str(k): [metre] for k, metre in enumerate(row["per_alignment"])}
    printed = row["published"]["min_human_distance_m"]
    what = f"Chapter 6: least human distance after 15 answers by the thesis's recipe (printed: {printed} m)"
    return _median(what, units, metres, f"{len(units)} alignments", stored)


def _explanations() -> Result:
    stored = _read("explained_room/benchmark_explanations.json")
    of_speed = [one for one in stored["explanations"] if one["command"] == "speed"]
    (one,) = [each for each in of_speed if each["method"] == "integrated_gradients"]
    low, high = one["deletion_interval_95"]
    worst = min(of_speed, key=lambda each: float(each["deletion_gain"]))
    what = "Chapter 8: how much more the speed moves when things go by their scores than at random"
    return Result(
        what,
        f"{one['deletion_gain']:.3f}",
        f"{low:.3f} to {high:.3f}",
        f"{worst['deletion_gain']:.3f} ({worst['method'].replace('_', ' ')})",
        f"{one['trajectories']} trajectories, {one['moments']:,} moments",
        stored,
    )


ALL: tuple[Callable[[], Result], ...] = (
    lambda: _headline("open_field", "open field"),
    lambda: _headline("study_room", "study room"),
    lambda: _headline("crowd_hall", "hall with walking people"),
    _people_predicted,
    lambda: _people_shown(
        AT_ONCE,
        "each_scene",
        "People who prefer, in at least five of up to six blind pairs, a policy that is chosen per scene after 15 "
        "right answers, and are shown it",
    ),
    lambda: _people_harmed(
        AT_ONCE, "each_scene", "People who are shown that policy to their harm (truly worse by more than 0.01)"
    ),
    lambda: _people_shown(
        BEHIND, "each_scene_trained", "The same with one policy more to choose from, trained on the answers behind it"
    ),
    lambda: _people_harmed(BEHIND, "each_scene_trained", "Shown that one to their harm"),
    lambda: _people_harmed(
        AT_ONCE, "instant", "Shown to their harm: one policy for all scenes, there at once, where the posterior is sure"
    ),
    _words,
    _training,
    _engine,
    _serving,
    _false_findings,
    _robot,
    _demonstrations,
    _depth,
    _pedestrians,
    _adaptable,
    _enquery,
    _explanations,
)


def results() -> str:
    """The page, Markdown."""
    found = [one() for one in ALL]
    table = ["| no. | what | result | interval | worst | over |", "|---|---|---|---|---|---|"]
    commands = ["| no. | command | file |", "|---|---|---|"]
    for k, one in enumerate(found, 1):
        table.append(f"| {k} | {one.what} | **{one.number}** | {one.interval} | {one.worst} | {one.over} |")
        commands.append(f"| {k} | `{one.stored.command}` | `{one.stored.file}` |")
    return "\n".join([INTRO, *table, "", "## How each number was made", "", *commands]) + "\n"
