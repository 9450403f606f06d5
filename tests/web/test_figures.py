"""Figures from plain numbers: well-formed SVG whose marks stand where the numbers say."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from desirepath.learning.policies.shipped import load_queries
from desirepath.simulation.scene import Person, Pose, Scene
from desirepath.simulation.trajectory import Outcome, Trajectory
from desirepath.web.core import svg_figures

SVG = "{http://www.w3.org/2000/svg}"


def parsed(svg: str) -> ElementTree.Element:
    return ElementTree.fromstring(svg)


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [(0, 1, [0, 0.2, 0.4, 0.6, 0.8, 1.0]), (0, 8_000, [0, 2_000, 4_000, 6_000, 8_000]), (3, 3, [3]), (-1, 1, None)],
)
def test_ticks_are_round_and_inside(low, high, expected):
    found = svg_figures.ticks(low, high)
    assert all(low <= tick <= high for tick in found)
    assert expected is None or found == expected


def test_small_numbers_keep_their_digits():
    told = svg_figures.exact(lambda value, digits: f"{value:.{digits}f}".replace(".", ","))
    assert [told(value) for value in (0.0005, 12.0, -2.25, 1e-7)] == ["0,0005", "12", "-2,25", "1e-07"]


def test_curve_rises_where_its_values_do_and_escapes_its_texts():
    drawn = parsed(svg_figures.curves({"": [(0, 1.0), (10, 3.0), (20, 2.0)]}, title="a < b & c", x_label="step"))
    points = [tuple(map(float, one.split(","))) for one in drawn.find(f"{SVG}polyline").get("points").split()]
    assert [x for x, _ in points] == sorted(x for x, _ in points)
    heights = [-y for _, y in points]
    assert heights[1] > heights[2] > heights[0]
    assert drawn.find(f"{SVG}title").text == "a < b & c"


def test_flat_curve_can_be_drawn():
    assert "polyline" in svg_figures.curves({"": [(5, 0.0), (5, 0.0)]}, title="flat", x_label="step")


def test_differences_are_counted_on_their_side_of_zero():
    values = np.concatenate([np.full(30, 0.5), np.full(10, -0.5), np.zeros(5)])
    drawn = parsed(
        svg_figures.differences(
            svg_figures.DifferenceBins.of(values, (0.2, 0.1, 0.3)),
            mean=(0.2, 0.1, 0.3),
            title="t",
            x_label="x",
            y_label="y",
        )
    )
    bars = {rect.get("class"): float(rect.get("height")) for rect in drawn.iter(f"{SVG}rect")}
    assert bars["fill-2"] == pytest.approx(3 * bars["fill-1"], rel=0.01)
    assert bars["fill-1"] == pytest.approx(2 * bars["fill-none"], rel=0.02)


def test_differences_of_no_scene_are_an_empty_frame():
    drawn = parsed(
        svg_figures.differences(
            svg_figures.DifferenceBins.of([], (0, 0, 0)), mean=(0, 0, 0), title="t", x_label="x", y_label="y"
        )
    )
    assert [rect.get("class") for rect in drawn.iter(f"{SVG}rect")] == ["paper"]


def test_intervals_have_a_row_each():
    rows = [svg_figures.Interval("P001", 0.8, 0.6, 0.9, "80 %"), svg_figures.Interval("<P2>", 0.5, 0.2, 0.7, "50 %")]
    drawn = parsed(svg_figures.intervals(rows, title="t", x_label="x", chance=0.5))
    whiskers = [line for line in drawn.iter(f"{SVG}line") if line.get("class") == "line-0"]
    dots = list(drawn.iter(f"{SVG}circle"))
    assert len(whiskers) == len(dots) == 2
    for whisker, dot in zip(whiskers, dots, strict=True):
        assert float(whisker.get("x1")) < float(dot.get("cx")) < float(whisker.get("x2"))


def test_drives_stay_inside_the_picture_and_long_names_are_cut():
    query = load_queries("study_room/queries_500").queries[0]
    pair = [query.trajectory_a, query.trajectory_b]
    svg = svg_figures.rollouts(query.scene, pair, names=["short", "a very long name of a policy " * 5], title="t")
    drawn = parsed(svg)
    width, height = float(drawn.get("width")), float(drawn.get("height"))
    paths = drawn.findall(f"{SVG}polyline")
    assert len(paths) == 2
    for path in paths:
        for x, y in (map(float, point.split(",")) for point in path.get("points").split()):
            assert 0 <= x <= width
            assert 0 <= y <= height
    assert len(drawn.findall(f"{SVG}polygon")) == len(query.scene.solids())
    assert re.search(r"a very long[^<]*…", svg)


def test_scene_without_a_room_is_drawn_around_its_drive():
    scene = Scene("open_field", 1, Pose(0, 0), Pose(3, 0), 0.4, Person(Pose(1, 1)))
    poses = np.array([[0, 0, 0], [1, 5, 0], [3, 0, 0]], np.float32)
    empty = np.zeros((2, 34), np.float32)
    drive = Trajectory(scene, Outcome.SUCCESS, poses, empty, empty[:, :2], empty[:, 0], empty, np.zeros(2, np.bool_))
    drawn = parsed(svg_figures.rollouts(scene, [drive], names=["one"], title="t"))
    assert float(drawn.get("height")) > 300
