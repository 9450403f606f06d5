"""`desirepath robot check` and `desirepath setup check`: what a lab brings, looked at before it is used."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from desirepath.cli.output import JsonFlag, plain_errors, say

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from desirepath.simulation.setups import Robot, Setup
    from desirepath.simulation.urdf import Look

robots = typer.Typer(help="Robots.", no_args_is_help=True)
setups = typer.Typer(help="Setups: a robot, a building and a task.", no_args_is_help=True)
T = TypeVar("T")
SCENES = 20  # drawn to see whether a setup gives any


@robots.command("check")
@plain_errors
def check_robot(
    file: Annotated[Path, typer.Argument(help="A robot.yaml, or the name of a shipped robot.")],
    picture: Annotated[Path | None, typer.Option(help="Draw it from above into this file: PNG, SVG or PDF.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Check a robot's description and its URDF; exit code 1 if one is not valid."""
    from desirepath.simulation.setup_files import read_robot, shipped_robots
    from desirepath.simulation.urdf import describe, read_looks

    robot = _checked(lambda: read_robot(shipped_robots().get(str(file), file)), as_json)
    urdf, looks = robot.urdf, []
    try:
        looks = _checked(lambda: read_looks(urdf), as_json) if urdf is not None else []
    finally:
        if picture is not None:
            draw_robot(robot, looks, picture)
    told = {
        "name": robot.name,
        "radius_m": round(robot.radius_m, 4),
        "inscribed_m": round(robot.inscribed_m, 4),
        "left_out": left_out(robot),
        **({"urdf": describe(looks)} if looks else {}),
    }
    say({"valid": True, "errors": [], **told}, as_json)


@setups.command("check")
@plain_errors
def check_setup_folder(
    folder: Annotated[Path, typer.Argument(help="A folder with a setup.yaml, whose name is the setup's.")],
    as_json: JsonFlag = False,
) -> None:
    """Check a setup and draw scenes in it; exit code 1 if it is not valid."""
    from desirepath.simulation.setup_files import check_setup

    setup = _checked(lambda: check_setup(folder.resolve()), as_json)
    told = _checked(lambda: _described(setup, folder), as_json)
    say({"valid": True, "errors": [], "setup": setup.name, **told}, as_json)


def _checked(read: Callable[[], T], as_json: bool) -> T:
    """What is read; where that fails, say every problem and end with 1."""
    from desirepath.grammar.source import ProtocolError

    try:
        return read()
    except ProtocolError as wrong:
        if as_json:
            say({"valid": False, "errors": wrong.errors}, as_json)
        for problem in () if as_json else wrong.problems:
            typer.echo(str(problem), err=True)
        raise typer.Exit(1) from None


def left_out(robot: Robot) -> list[str]:
    """What a description does not say, and what is taken instead."""
    limits = robot.limits
    assumed = {
        "limits.v_change: it changes its speed as quickly as it is told to": limits.v_change is None,
        "limits.w_change: it changes its turning as quickly as it is told to": limits.w_change is None,
        "source: nobody can look its numbers up": not robot.source,
    }
    return [what for what, missing in assumed.items() if missing]


def _described(setup: Setup, folder: Path) -> dict[str, Any]:
    """What a setup's building has, and what scenes drawn in it are like. Raises ProtocolError for scenes that cannot be
    drawn, or not be driven in."""
    from desirepath.grammar.source import Problem, ProtocolError
    from desirepath.simulation.scene import SceneError
    from desirepath.simulation.scenes import check_scene, draw_scenes, map_of
    from desirepath.simulation.setups import SETUP_FILE
    from desirepath.simulation.urdf import describe, read_looks

    told: dict[str, Any] = {}
    here = map_of(setup)
    if here is not None:
        cells = here.cell_m**2
        told["map"] = {
            "size_m": [round(side, 2) for side in here.size_m],
            "free_m2": round(float((~here.blocked).sum()) * cells, 1),
            "in_reach_m2": round(float(here.roomy(setup.robot.radius_m).sum()) * cells, 1),
            "unknown_share": round(float(here.unknown.mean()), 3),
        }
    if setup.robot.urdf is not None:  # of which driving needs nothing
        try:
            told["urdf"] = describe(read_looks(setup.robot.urdf))
        except ProtocolError as wrong:
            told["not_shown"] = [str(problem) for problem in wrong.problems]
    try:
        scenes = draw_scenes(setup, range(SCENES))
        for scene in scenes:
            check_scene(scene, setup)
    except SceneError as wrong:
        raise ProtocolError([Problem(str(folder / SETUP_FILE), 1, f"scene.{wrong.field}", None, str(wrong))]) from None
    ways = sorted(math.dist((one.start.x, one.start.y), (one.goal.x, one.goal.y)) for one in scenes)
    told["scenes"] = {"drawn": len(ways), "shortest_m": round(ways[0], 2), "longest_m": round(ways[-1], 2)}
    return told


def draw_robot(robot: Robot, looks: Sequence[Look], picture: Path) -> None:
    """Its body from above, what its URDF shows, the circles in and around it, its lidar and what that does not see."""
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Polygon, Wedge

    figure = Figure(figsize=(4, 4))
    ax = figure.add_subplot()
    body = Polygon(robot.footprint) if robot.footprint else Circle((0, 0), robot.radius_m)
    body.set(facecolor="#d9d4c7", edgecolor="#222")
    ax.add_patch(body)
    for look in looks:
        colour = [part / 255 for part in look.colour]
        ax.add_collection(PolyCollection([*look.triangles[..., :2]], facecolor=colour, alpha=0.35, rasterized=True))
    for radius in {robot.radius_m, robot.inscribed_m}:
        ax.add_patch(Circle((0, 0), radius, fill=False, linestyle=":", edgecolor="#888"))
    lidar, reach = robot.lidar, 1.6 * robot.radius_m
    middle, half = math.degrees(lidar.yaw_rad), math.degrees(lidar.field_of_view_rad) / 2
    seen = Wedge((lidar.x_m, lidar.y_m), reach, middle - half, middle + half, alpha=0.15, facecolor="#1f6f4a")
    ax.add_patch(seen)
    ax.plot(lidar.x_m, lidar.y_m, "o", color="#1f6f4a", markersize=4)
    ax.annotate("", (1.4 * robot.radius_m, 0), (0, 0), arrowprops={"arrowstyle": "->"})
    ax.set(xlim=(-2 * robot.radius_m, 2 * robot.radius_m), ylim=(-2 * robot.radius_m, 2 * robot.radius_m))
    ax.set(aspect="equal", xlabel="x (m), ahead", ylabel="y (m), left", title=robot.name)
    figure.savefig(picture, bbox_inches="tight")
