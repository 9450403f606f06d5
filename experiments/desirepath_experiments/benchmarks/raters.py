"""`desirepath benchmark raters DIR`: do measures of comfort, fitted to all raters but one, order that one's scenes?

Moments without motion as SocNav1 has them (L. J. Manso et al., CC BY 4.0): a file per rater, a JSON object a line with
`score` (0-100), `room` (polygon), `humans` and `objects` (`xPos`, `yPos` in cm, a person's `orientation` in degrees,
clockwise from +y) and `links` (who is busy with whom or what); the robot stands at the origin.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import BaseModel, Field
from pydantic.dataclasses import dataclass
from scipy.optimize import minimize

from desirepath.recordings.recording import read_bounded
from desirepath_experiments.benchmarks.results import Progress

Doubles = NDArray[np.float64]
MOST_BYTES, MOST_RATERS, MOST_SCENES = 20_000_000, 50, 20_000
NEAR_M = (0.5, 0.8, 1.2, 1.6, 2.0, 3.0, 4.0)  # within these a person counts, squared towards the robot
SIDES_M = (0.8, 1.2, 2.0, 3.0)
BETWEEN_M = 0.8
APART = 10  # points of 100 from which two scores are an order

Centimetres = Annotated[float, Field(ge=-10_000, le=10_000, allow_inf_nan=False)]


class _Placed(BaseModel):
    id: int
    x: Centimetres = Field(alias="xPos")
    y: Centimetres = Field(alias="yPos")


class _Person(_Placed):
    orientation: Annotated[float, Field(ge=-360, le=360, allow_inf_nan=False)]


class RatedScene(BaseModel):
    """One moment and what a rater gave it."""

    score: Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)]
    room: Annotated[list[tuple[Centimetres, Centimetres]], Field(min_length=3, max_length=200)]
    humans: Annotated[list[_Person], Field(max_length=100)]
    objects: Annotated[list[_Placed], Field(max_length=100)]
    links: Annotated[list[tuple[int, int, str]], Field(max_length=400)]


@dataclass(frozen=True)
class RatersConfig:
    """What is read and how strongly weights are held back."""

    folder: Annotated[Path, Field(description="One JSON file per rater, a rated scene a line.")]
    pairs: Annotated[int, Field(ge=100, le=100_000, description="Drawn of each rater to fit.")] = 6_000
    shrinkage: Annotated[float, Field(gt=0, le=10, description="Ridge on standardised weights.")] = 0.001
    seed: int = 0


def benchmark_raters(config: RatersConfig, progress: Progress | None = None) -> dict[str, Any]:
    """Share of each rater's pairs (scores `APART` or more apart) in the order of weights fitted to the others.

    raters: {name: {scenes, pairs, accuracy}}. without, alone: median accuracy over raters with a group of measures left
    out, and with nothing else. agreement: between two raters who rated 10 common scenes, in these. weights: fitted to
    all, standardised, the strongest first. Raises ValueError by file and line, RecordingError for no readable file.
    """
    tell = progress.tell if progress else lambda words: None
    rated = read_raters(config.folder)
    scores = {name: np.array([scene.score for _, scene in scenes]) for name, scenes in rated.items()}
    tables = {name: np.array([measure(scene) for _, scene in scenes]) for name, scenes in rated.items()}
    fit = RatersFit(config, tables, scores)
    everything = np.ones(len(COLUMNS), dtype=np.bool_)
    accuracy = fit.left_out(everything)
    tell(f"median {np.median(list(accuracy.values())):.3f} of {len(rated)} raters")
    groups = list(dict.fromkeys(group for group, _ in COLUMNS))
    belongs = {group: np.array([own == group for own, _ in COLUMNS]) for group in groups}
    weights = fit.weights(everything, list(rated))
    strongest = sorted(zip((name for _, name in COLUMNS), weights, strict=True), key=lambda pair: -abs(pair[1]))
    return {
        "raters": {
            name: {"scenes": len(scores[name]), "pairs": _order(scores[name])[0].size, "accuracy": accuracy[name]}
            for name in rated
        },
        "median_accuracy": _median(accuracy),
        "least_accuracy": min(accuracy.values()),
        "without": {group: _median(fit.left_out(~belongs[group])) for group in groups},
        "alone": {group: _median(fit.left_out(belongs[group])) for group in groups},
        "agreement": _agreement(rated),
        "weights": dict(strongest[:12]),
    }


def read_raters(folder: Path) -> dict[str, list[tuple[str, RatedScene]]]:
    """Rater -> (what names the scene, the scene). Two raters' scenes are the same where all but the score is."""
    files = sorted(folder.glob("*.json")) if folder.is_dir() else []
    if not 2 <= len(files) <= MOST_RATERS:
        raise ValueError(f"{folder.name}: {len(files)} JSON files; one for each of 2 to {MOST_RATERS} raters")
    rated = {}
    for file in files:
        lines = [line for line in read_bounded(file, MOST_BYTES).splitlines() if line.strip()]
        if len(lines) > MOST_SCENES:
            raise ValueError(f"{file.name}: {len(lines)} scenes; at most {MOST_SCENES} are read")
        rated[file.stem] = [_read_scene(file.name, number, line) for number, line in enumerate(lines, 1)]
        if not _order(np.array([scene.score for _, scene in rated[file.stem]]))[0].size:
            raise ValueError(f"{file.name}: no two scores are {APART} points apart; nothing to order")
    return rated


def _read_scene(file: str, number: int, line: bytes) -> tuple[str, RatedScene]:
    try:
        scene = RatedScene.model_validate_json(line)
    except pydantic.ValidationError as wrong:
        problem = wrong.errors(include_url=False)[0]
        where = ".".join(str(part) for part in problem["loc"])
        raise ValueError(f"{file}, line {number}: {where}: {problem['msg']}") from None
    return json.dumps(scene.model_dump(exclude={"score"})), scene


def measure(scene: RatedScene) -> list[float]:
    """What `COLUMNS` name, of the robot at the origin; all grow with what may disturb."""
    apart, ahead = _people(scene)
    values: list[float] = []
    for radius in NEAR_M:
        near = np.maximum(0, 1 - apart / radius) ** 2
        values += [near.max(initial=0), near.sum()]
    for radius in SIDES_M:
        near = np.maximum(0, 1 - apart / radius) ** 2
        values += [float(near @ of) for of in (np.maximum(0, ahead), np.maximum(0, -ahead), 1 - np.abs(ahead))]
    wall, things = _surroundings(scene)
    values += [max(0.0, 1 - wall / reach) ** 2 for reach in (0.5, 1.0)]
    values += [float((np.maximum(0, 1 - things / reach) ** 2).sum()) for reach in (0.5, 1.0, 2.0)]
    x, y = np.array(scene.room).T / 100
    area = abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    values += [*_between(scene), float(len(apart)), float((apart < 3).sum()), len(apart) / max(area, 1)]
    return values


COLUMNS = (
    *(("distance", f"{what} within {radius} m") for radius in NEAR_M for what in ("nearest person", "people")),
    *(("side", f"{what} within {radius} m") for radius in SIDES_M for what in ("in front", "behind", "beside")),
    *(("walls", f"wall within {reach} m") for reach in (0.5, 1.0)),
    *(("objects", f"object within {reach} m") for reach in (0.5, 1.0, 2.0)),
    *(("between", "between two people"), ("between", "between a person and a thing")),
    *(("crowd", "people in the room"), ("crowd", "people within 3 m"), ("crowd", "people per square metre")),
)
"""Group and name of what `measure` gives, in its order."""


def look_around(scene: RatedScene) -> tuple[Doubles, Doubles, float]:
    """How far everybody is, m, the cosine of where the robot is for them (1: straight ahead), and how far the nearest
    wall or thing is, m."""
    wall, things = _surroundings(scene)
    return *_people(scene), min(wall, float(things.min()))


def _people(scene: RatedScene) -> tuple[Doubles, Doubles]:
    people = np.array([(person.x, person.y) for person in scene.humans]).reshape(-1, 2) / 100
    facing = np.radians([person.orientation for person in scene.humans])
    apart = np.linalg.norm(people, axis=1)
    ahead = -(people * np.column_stack([np.sin(-facing), np.cos(facing)])).sum(1) / np.maximum(apart, 1e-6)
    return apart, ahead


def _surroundings(scene: RatedScene) -> tuple[float, Doubles]:
    """How far the nearest wall is, m, and every thing."""
    corners = np.array(scene.room) / 100
    wall = min(_apart(a, b)[0] for a, b in zip(corners, np.roll(corners, -1, 0), strict=True))
    things = np.linalg.norm([(thing.x / 100, thing.y / 100) for thing in scene.objects] or [(1e6, 1e6)], axis=1)
    return wall, things


def _between(scene: RatedScene) -> tuple[float, float]:
    """How much the robot stands between two people who are busy with each other, and a person and a thing; 0 to 1."""
    places = {one.id: np.array([one.x, one.y]) / 100 for one in (*scene.humans, *scene.objects)}
    persons, worst = {person.id for person in scene.humans}, [0.0, 0.0]
    for one, other, _ in scene.links:
        if one in places and other in places:
            apart, along = _apart(places[one], places[other])
            kind = int(not {one, other} <= persons)
            worst[kind] = max(worst[kind], max(0.0, 1 - apart / BETWEEN_M) ** 2 * 4 * along * (1 - along))
    return worst[0], worst[1]


def _apart(begin: Doubles, end: Doubles) -> tuple[float, float]:
    """Distance of the origin to a segment, m, and where along it (0-1) it is nearest."""
    way = end - begin
    along = float(np.clip(-(begin @ way) / max(float(way @ way), 1e-12), 0, 1))
    return float(np.linalg.norm(begin + along * way)), along


class RatersFit:
    """Weights of measures by pairs within each rater: logistic, ridge; no scores of two raters are ever compared."""

    def __init__(self, config: RatersConfig, tables: dict[str, Doubles], scores: dict[str, Doubles]) -> None:
        self.tables, self.scores, self.shrinkage = tables, scores, config.shrinkage
        random = np.random.default_rng(config.seed)
        whole = np.vstack(list(tables.values()))
        self.scale = np.maximum(whole.std(0), 1e-9)
        self.differences: dict[str, Doubles] = {}
        for name, table in tables.items():
            better, worse = _order(scores[name])
            drawn = random.integers(better.size, size=min(config.pairs, better.size))
            self.differences[name] = (table[better[drawn]] - table[worse[drawn]]) / self.scale

    def weights(self, kept: NDArray[np.bool_], raters: Sequence[str]) -> Doubles:
        """Of the kept measures, standardised; 0 of the others."""
        better = np.vstack([self.differences[name][:, kept] for name in raters])

        def loss(w: Doubles) -> tuple[float, Doubles]:
            margin = better @ w
            slope = -better.T @ (1 / (1 + np.exp(np.minimum(margin, 500)))) / len(better)
            return float(np.logaddexp(0, -margin).mean() + self.shrinkage * w @ w), slope + 2 * self.shrinkage * w

        weights = np.zeros(kept.size)
        weights[kept] = minimize(loss, np.zeros(int(kept.sum())), jac=True, method="L-BFGS-B").x
        return weights

    def left_out(self, kept: NDArray[np.bool_]) -> dict[str, float]:
        """Rater -> share of its pairs in the order of weights fitted to all others; a tie counts half."""
        accuracy = {}
        for name in self.tables:
            weights = self.weights(kept, [other for other in self.tables if other != name])
            accuracy[name] = _same_order(self.tables[name] / self.scale @ weights, self.scores[name])
        return accuracy


def _order(scores: Doubles) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Every pair of scenes that are `APART` or more apart: the better, the worse."""
    better, worse = np.nonzero(scores[:, None] - scores >= APART)
    return better, worse


def _same_order(predicted: Doubles, scores: Doubles) -> float:
    better, worse = _order(scores)
    ahead = predicted[better] - predicted[worse]
    return float(((ahead > 0) + 0.5 * (ahead == 0)).mean())


def _agreement(rated: dict[str, list[tuple[str, RatedScene]]]) -> dict[str, dict[str, float]]:
    """Of two raters with 10 common scenes or more: in how many pairs that one orders the other has the same order."""
    by_scene = {name: {key: scene.score for key, scene in scenes} for name, scenes in rated.items()}
    found = {}
    for one in by_scene:
        for other in by_scene:
            common = sorted(by_scene[one].keys() & by_scene[other].keys())
            if one < other and len(common) >= 10:
                a, b = (np.array([by_scene[name][key] for key in common]) for name in (one, other))
                both = (_same_order(b, a), _same_order(a, b))
                found[f"{one}-{other}"] = {"scenes": len(common), "least": min(both), "most": max(both)}
    return found


def _median(accuracy: dict[str, float]) -> float:
    return float(np.median(list(accuracy.values())))
