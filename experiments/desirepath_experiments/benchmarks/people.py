"""`desirepath benchmark people`: how well simulated people outside the nine objectives are predicted, who is shown a
robot as theirs, what it gains them, whom it harms, how sure that was: one row per family. Nobody here is real.

They are asked and shown what a study asks and shows (`people_room.py`, `people_ways.py`); by their true score it is
measured in scenes that chose nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
import torch
from pydantic import Field

from desirepath.analysis.estimates import interval, mean_estimate, resample_rows, wilson
from desirepath.learning.alignment.each_scene import KEPT
from desirepath.learning.errors import LearningError
from desirepath.learning.people.asked_people import NINE, RATERS, people_of, prior_for
from desirepath.learning.people.card import people_card, response_models
from desirepath.learning.people.families.base import FamilyMember
from desirepath.learning.people.reward_file import read_reward
from desirepath.learning.people.rows import bins_of, calibration_error
from desirepath.learning.policies.choosing import Before
from desirepath.learning.preferences.oracles import ResponseModel
from desirepath.learning.preferences.population_prior import IN_GENERAL
from desirepath.learning.queries.choosing import STRATEGIES
from desirepath_experiments.benchmarks.people_room import PeopleRoom, QueryPool, RobotOfLibrary
from desirepath_experiments.benchmarks.people_ways import WAYS, WaysConfig
from desirepath_experiments.benchmarks.results import Progress
from desirepath_experiments.reproduction.tasks import worker_pool

NOTHING = 0.01  # typical differences: a mean gain within this is none
WORTH_A_SHARE = 0.05  # where the yardstick gains less there is nothing to have a share of
YARDSTICKS = {
    **dict.fromkeys(("by_senses", "by_senses_truly", "at_start"), "trained"),
    **dict.fromkeys(("each_scene", "each_scene_trained"), "best_in_each"),
}
FAMILY = "Families of the card, comma-separated, nine, raters; tuning, held_out, unseen, all (these and nine); none."


@pydantic.dataclasses.dataclass(frozen=True)
class PeopleConfig:
    """Who is asked, what their robot is given, and where it is measured."""

    setup: Annotated[str, Field(description="study_room or open_field: with step basis and library.")] = "study_room"
    family: Annotated[str, Field(description=FAMILY)] = "tuning"
    people: Annotated[int, Field(ge=1, le=1_000, description="Of each family and seed.")] = 4
    first: Annotated[int, Field(ge=0, description="Number of the first person of each family.")] = 0
    seeds: Annotated[
        tuple[int, ...], Field(min_length=1, description="FIRST-LAST; each has scenes and people of its own.")
    ] = (0,)
    reward: Annotated[
        Path | None, Field(description="Also a fitted reward as a person: a manifest (.json) or a model of the store.")
    ] = None
    answers: Annotated[
        tuple[int, ...], Field(min_length=1, description="After how many it is predicted; the last ones are gone by.")
    ] = (8, 15)
    choose: Annotated[str, Field(description="How the next question is chosen.")] = "information"
    queries: Annotated[str, Field(description="Query set; default: SETUP/queries_varied_200.")] = ""
    prior: Annotated[
        Literal["none", "people_in_general"], Field(description="By the light of what own answers are read.")
    ] = "none"
    response_model: Annotated[str, Field(description="right, lapses, indifference, peak_end or first_seconds.")] = (
        "right"
    )
    ways: Annotated[str, Field(description=f"Of: {','.join(WAYS)}.")] = "each_scene"
    compared: Annotated[int, Field(ge=0, description="Comparisons with the base policy, after the answers.")] = 6
    kept: Annotated[int, Field(ge=1, description="Policies that a choice per scene has to choose from.")] = KEPT
    updates: Annotated[
        int, Field(ge=0, description="Also a policy to choose from that is trained on the answers by so many updates.")
    ] = 0
    own_senses: Annotated[
        int, Field(ge=0, description="In so many of the scenes the choice per scene also drives by the robot's senses.")
    ] = 0
    trained_s: Annotated[
        float, Field(ge=0, description="Beside it the base policy, trained so long on their true score of every step.")
    ] = 0.0
    pretraining: Annotated[
        str,
        Field(description="A folder with SETUP/base.npz, conditioned.npz and policy_library.npz; default shipped."),
    ] = ""
    processes: Annotated[int, Field(ge=1, description="Seeds at a time.")] = 1
    test: Annotated[int, Field(ge=4, description="Pairs that are predicted.")] = 200
    scenes: Annotated[int, Field(ge=1, description="Fresh ones in which gains are measured.")] = 100

    @property
    def families(self) -> tuple[str, ...]:
        card = people_card()
        everybody = (*card.families, NINE)
        groups = {"tuning": card.tuning, "held_out": card.held_out, "unseen": card.unseen, "all": everybody, "none": ()}
        return groups.get(self.family) or tuple(name for name in self.family.split(",") if name not in ("", "none"))

    @property
    def of_ways(self) -> WaysConfig:
        return WaysConfig(self.compared, self.kept, self.updates, self.own_senses, self.trained_s)


def benchmark_people(config: PeopleConfig, progress: Progress) -> dict[str, Any]:
    """{"simulated", "setup", "config", "predicted", "ways", "persons"}; rows of everybody ("all") come first, then of
    each family; rates and medians are followed by their 95 %.

    `predicted`: by number of answers, share of fresh pairs (mean over people, and the least), what was claimed, how far
    these are apart. `ways`, and the yardsticks beside them: `gain` of everybody, `share` of what the yardstick gains
    and, where not everybody is shown it, `shown`, `gain_of_shown`, `better_of_shown`, `harmed`, `harmed_of_shown`.
    Gains: over the base policy, in typical differences of a pair, median over people with lowest quarter and least;
    harmed: shown, and worse by more than `NOTHING`. A run that was stopped goes on from its file. Raises LearningError
    for unknown names, and where the setup has no step basis or no policy library.
    """
    _check(config)
    done = {(stored["seed"], stored["person"]): stored for stored in progress.kept_persons(config.setup, config)}
    RobotOfLibrary.load(config.setup, config.pretraining)
    with worker_pool(config.processes) if config.processes > 1 else nullcontext() as pool:
        if pool is None:
            measured = (one for seed in config.seeds for one in _measure_seed(seed, config, done))
        else:
            runs = [pool.submit(_measure_whole_seed, seed, config, done) for seed in config.seeds]
            measured = (one for run in as_completed(runs) for one in run.result())
        for one in measured:
            done[one["seed"], one["person"]] = one
            progress.tell(f"{one['seed']} {one['person']}")
            progress.keep(_result(config, done))
    return _result(config, done)


def _measure_whole_seed(
    seed: int, config: PeopleConfig, done: Mapping[tuple[int, str], dict[str, Any]]
) -> list[dict[str, Any]]:
    torch.set_num_threads(1)
    return list(_measure_seed(seed, config, done))


def _measure_seed(seed: int, config: PeopleConfig, done: Mapping[tuple[int, str], Any]) -> Iterator[dict[str, Any]]:
    """Everybody of a seed who is not done."""
    left = [one for one in _everybody(seed, config) if (seed, one[1]) not in done]
    if not left:
        return
    robot = RobotOfLibrary.load(config.setup, config.pretraining)
    pool = QueryPool.load(config.queries or f"{config.setup}/queries_varied_200", robot.basis)
    answering = ResponseModel(**response_models([config.response_model])[config.response_model])
    room = PeopleRoom.open(seed, robot, pool, test=config.test, scenes=config.scenes)
    for family, name, person in left:
        yield {"family": family, "person": name, "seed": seed} | _measure(person, room, answering, config)


def _result(config: PeopleConfig, done: Mapping[tuple[int, str], dict[str, Any]]) -> dict[str, Any]:
    names = [(seed, name) for seed in config.seeds for _, name, _ in _everybody(seed, config)]
    persons = [done[key] for key in names if key in done]
    families = list(dict.fromkeys(str(person["family"]) for person in persons))
    groups = {"all": persons} | {family: [one for one in persons if one["family"] == family] for family in families}
    return {
        "simulated": True,
        "setup": config.setup,
        "config": asdict(config),
        "predicted": [row for name, of in groups.items() for row in _predicted(name, of)],
        "ways": [row for name, of in groups.items() for row in _ways(name, of)],
        "persons": persons,
    }


def _check(config: PeopleConfig) -> None:
    card = people_card()
    known = {"family": (*card.families, NINE, RATERS), "choose": tuple(STRATEGIES), "ways": tuple(WAYS)}
    asked = {"family": config.families, "choose": (config.choose,), "ways": tuple(config.ways.split(","))}
    for field, names in asked.items():
        if unknown := [name for name in names if name not in known[field]]:
            raise LearningError(f"{field} = {unknown[0]!r}: known are {', '.join(known[field])}")


def _everybody(seed: int, config: PeopleConfig) -> Iterator[tuple[str, str, FamilyMember]]:
    """Family, name and person, families in turns, so that an unfinished run is of all of them."""
    first = config.first + seed * config.people
    people = {family: people_of(family, config.people, config.setup, first) for family in config.families}
    for turn in zip(*(of.items() for of in people.values()), strict=True):
        for family, (name, person) in zip(people, turn, strict=True):
            yield family, name, person
    if config.reward is not None:
        yield "file", config.reward.stem, read_reward(config.reward, config.setup)


def _measure(person: FamilyMember, room: PeopleRoom, answering: ResponseModel, config: PeopleConfig) -> dict[str, Any]:
    """One person: asked, predicted as they are when all is answered, shown or not."""
    person = person.after(max(config.answers))
    before = Before(prior_for(person, config.setup)) if config.prior == IN_GENERAL else None
    asked = room.ask(person, config.choose, answering, config.answers, before)
    pairs = room.predicted
    truth = pairs.better(person.scores(pairs.in_turn))[pairs.test] > 0
    result: dict[str, Any] = {"predicted": {}, "claimed": {}, "bins": {}}
    for n, answers in asked.after.items():
        probable = answers.believed[0].predict(pairs.differences[pairs.test])
        sure, right = np.maximum(probable, 1 - probable), (probable > 0.5) == truth
        result["predicted"][str(n)] = float(right.mean())
        result["claimed"][str(n)] = float(sure.mean())
        result["bins"][str(n)] = bins_of(sure, right)
    for way in config.ways.split(","):
        result |= WAYS[way](person, asked.whole, room, answering, config.of_ways)
    return result


def _predicted(family: str, persons: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    for n in persons[0]["predicted"] if persons else ():
        predicted = [person["predicted"][n] for person in persons]
        estimate = mean_estimate(predicted)
        yield {
            "family": family,
            "people": len(persons),
            "answers": int(n),
            "predicted": _rounded(estimate.value, estimate.low, estimate.high),
            "least": min(predicted),
            "claimed": round(float(np.mean([person["claimed"][n] for person in persons])), 3),
            "calibration_error": round(calibration_error([person["bins"][n] for person in persons]), 3),
        }


def _ways(family: str, persons: Sequence[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    names = dict.fromkeys(name for one in persons for name, of in one.items() if isinstance(of, dict) and "gain" in of)
    for way in names:
        of_way = [person[way] for person in persons if way in person]
        row = {"family": family, "way": way, "people": len(of_way)} | _way_of(of_way)
        if whole := YARDSTICKS.get(way):
            row |= _share_of([(person[way], person[whole]) for person in persons if whole in person and way in person])
        yield row


def _way_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Over people."""
    found = {f"gain{key}": of for key, of in _spread([row["gain"] for row in rows]).items()}
    found["success"] = float(np.mean([row["success"] for row in rows]))
    found |= {
        key: float(np.median([row[key] for row in rows]))
        for key in ("switches", "jerk", "jerk_of_base", "decision_ms", "seconds")
        if key in rows[0]
    }
    if "shown" not in rows[0]:
        return found
    shown = [row["gain"] for row in rows if row["shown"]]
    harmed, better = (sum(sign * gain > NOTHING for gain in shown) for sign in (-1, 1))
    found |= {"shown": _rate(len(shown), len(rows)), "harmed": _rate(harmed, len(rows))}
    if shown:
        found |= {"better_of_shown": _rate(better, len(shown)), "harmed_of_shown": _rate(harmed, len(shown))}
        found |= {f"gain_of_shown{key}": of for key, of in _spread(shown).items()}
    return found


def _share_of(pairs: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> dict[str, Any]:
    """Of what the yardstick gains, of the people to whom that gives something."""
    shares = [part["gain"] / of["gain"] for part, of in pairs if of["gain"] > WORTH_A_SHARE]
    return {f"share{key}": of for key, of in _spread(shares).items()} if shares else {}


def _spread(values: Sequence[float]) -> dict[str, Any]:
    """The median over people with its 95 % (resampled), the lowest quarter, the least."""
    numbers = np.asarray(values)
    of = interval(float(np.median(numbers)), np.median(numbers[resample_rows(len(numbers))], axis=1))
    quarter, least = _rounded(float(np.quantile(numbers, 0.25)), float(numbers.min()))
    return {"": _rounded(of.value, of.low, of.high), "_quarter": quarter, "_least": least}


def _rate(hits: int, n: int) -> list[float]:
    """With Wilson's 95 %."""
    of = wilson(hits, n)
    return _rounded(of.value, of.low, of.high)


def _rounded(*values: float) -> list[float]:
    return [round(value, 3) for value in values]
