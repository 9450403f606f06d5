"""Measures of comfort, fitted to raters: a made-up taste is found in a rater left out; bad lines are named."""

import json
from pathlib import Path

import numpy as np
import pytest

from desirepath_experiments.benchmarks.raters import COLUMNS, RatedScene, RatersConfig, benchmark_raters, measure

ROOM = [[-500, -500], [500, -500], [500, 500], [-500, 500]]


def _scene(random: np.random.Generator) -> dict[str, object]:
    people = [
        {"id": 1 + k, "xPos": float(random.uniform(-400, 400)), "yPos": float(random.uniform(-400, 400))}
        | {"orientation": float(random.uniform(-180, 180))}
        for k in range(int(random.integers(1, 4)))
    ]
    nearest_m = min(np.hypot(one["xPos"], one["yPos"]) for one in people) / 100
    score = float(np.clip(100 * nearest_m / 4, 0, 100))
    return {"score": score, "room": ROOM, "humans": people, "objects": [], "links": []}


def _write(folder: Path, rater: str, scenes: list[dict[str, object]]) -> None:
    (folder / f"{rater}.json").write_text("\n".join(json.dumps(scene) for scene in scenes), encoding="utf-8")


def test_taste_for_distance_is_predicted_in_a_rater_left_out(tmp_path: Path) -> None:
    for seed, rater in enumerate("abc"):
        random = np.random.default_rng(seed)
        _write(tmp_path, rater, [_scene(random) for _ in range(40)])
    result = benchmark_raters(RatersConfig(folder=tmp_path, pairs=400))
    assert set(result["raters"]) == {"a", "b", "c"}
    assert result["least_accuracy"] > 0.9
    assert result["without"]["walls"] > 0.9 > result["alone"]["walls"]


def test_bad_line_is_named(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    _write(tmp_path, "a", [_scene(random) for _ in range(9)])
    _write(tmp_path, "b", [_scene(random), _scene(random) | {"score": 101}])
    with pytest.raises(ValueError, match=r"b\.json, line 2: score: .*less than or equal to 100"):
        benchmark_raters(RatersConfig(folder=tmp_path))


@pytest.mark.parametrize(("orientation", "name"), [(180, "in front"), (0, "behind")])
def test_person_to_the_north_looks_south_at_the_robot(orientation: float, name: str) -> None:
    person = {"id": 1, "xPos": 0, "yPos": 100, "orientation": orientation}
    scene = RatedScene.model_validate({"score": 1, "room": ROOM, "humans": [person], "objects": [], "links": []})
    values = dict(zip((name for _, name in COLUMNS), measure(scene), strict=True))
    seen = {side: values[f"{side} within 2.0 m"] for side in ("in front", "behind", "beside")}
    assert seen.pop(name) == pytest.approx(0.25)
    assert all(value == pytest.approx(0) for value in seen.values())
