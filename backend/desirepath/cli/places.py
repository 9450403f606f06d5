"""`desirepath robots ...` and `desirepath setups ...`: what there is; what a lab brings, checked and trained for."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from desirepath.cli.output import JsonFlag, in_data_folder, say, working

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from desirepath.simulation.setups import Robot
    from desirepath.simulation.urdf import Look

robots = typer.Typer(help="Robots.", no_args_is_help=True)
setups = typer.Typer(help="Setups: a robot, a building and a task.", no_args_is_help=True)
T = TypeVar("T")


@robots.command("list")
@in_data_folder
def list_robots(as_json: JsonFlag = False) -> None:
    """List the robots that are shipped."""
    from desirepath.simulation.setup_files import read_robot, shipped_robots

    found = {name: read_robot(file) for name, file in shipped_robots().items()}
    rows = [
        {"robot": name, "radius_m": robot.radius_m, "v_max": robot.limits.v_max, "w_max": robot.limits.w_max}
        for name, robot in found.items()
    ]
    say({"robots": rows}, as_json)


@robots.command("check")
@in_data_folder
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


@setups.command("list")
@in_data_folder
def list_setups(as_json: JsonFlag = False) -> None:
    """List the setups that are shipped, and those of this installation."""
    from desirepath.simulation.setups import SETUPS, broken_setups, is_shipped, setup_folders

    broken = broken_setups()
    rows = [
        {
            "setup": name,
            "robot": SETUPS[name].robot.name if name not in broken else None,
            "from": "shipped" if is_shipped(folder) else str(folder),
            "problem": broken.get(name),
        }
        for name, folder in setup_folders().items()
    ]
    say({"setups": rows}, as_json)


@setups.command("show")
@in_data_folder
def show_setup(
    setup: Annotated[str, typer.Argument(help="Name of a setup.")],
    as_json: JsonFlag = False,
) -> None:
    """Show what policies of a setup are given and give.

    So the manifest beside an ONNX file must say it, which `--json` prints.
    """
    from desirepath.learning.policies.manifest import setup_manifest
    from desirepath.simulation.setups import get_setup

    say({"setup": setup, **setup_manifest(get_setup(setup))}, as_json)


@setups.command("check")
@in_data_folder
def check_setup_folder(
    folder: Annotated[Path, typer.Argument(help="A folder with a setup.yaml, whose name is the setup's.")],
    as_json: JsonFlag = False,
) -> None:
    """Check a setup and draw scenes in it; exit code 1 if it is not valid."""
    from desirepath.simulation.setup_files import check_setup
    from desirepath.simulation.setup_intake import describe

    setup = _checked(lambda: check_setup(folder.resolve()), as_json)
    told = _checked(lambda: describe(setup, folder), as_json)
    say({"valid": True, "errors": [], "setup": setup.name, **told}, as_json)


@setups.command("train")
@in_data_folder
def train_setup_folder(
    folder: Annotated[Path, typer.Argument(help="A folder with a setup.yaml, whose name is the setup's.")],
    seed: Annotated[int, typer.Option(min=0, max=9_999, help="Seed of everything random.")] = 0,
    queries: Annotated[int, typer.Option(min=10, max=2_000, help="Pairs in each query set.")] = 200,
    effort: Annotated[
        float,
        typer.Option(
            min=0.001, max=10, help="Multiple of the default updates: 1 to use it, 0.05 to check that everything runs."
        ),
    ] = 1.0,
    randomise: Annotated[
        bool,
        typer.Option("--randomise", help="Learn with robots whose lidar is noisy, whose wheels lag, slip, are slow."),
    ] = False,
    as_json: JsonFlag = False,
) -> None:
    """Train what studies in a setup need: policies, an ensemble, query sets.

    All is put into its folder. What is there already stays; stopped and asked again, it goes on.
    """
    from desirepath.simulation.setup_files import check_setup
    from desirepath.simulation.setup_intake import describe

    setup = _checked(lambda: check_setup(folder.resolve()), as_json)
    _checked(lambda: describe(setup, folder), as_json)
    from desirepath.learning.shipping.own_setup import SetupTrainingConfig, in_words, train_setup
    from desirepath.simulation.setups import include

    said: set[tuple[str, float]] = set()
    with working(f"{setup.name}: looking how fast this machine learns there") as update:

        def told(stage: str, fraction: float, metrics: dict[str, float], left_s: float) -> None:
            update(f"{stage.replace('_', ' ')} {fraction:.0%}, {in_words(left_s)} left")
            restart = (stage, metrics.get("begun_anew", 0.0))
            if restart[1] and restart not in said:
                said.add(restart)
                typer.echo(
                    f"{stage}: stood still after {metrics['updates']:.0f} updates "
                    f"({metrics['success_rate']:.0%} arrive); begun anew with another seed and a guide",
                    err=True,
                )
            if fraction == 0.0 and not metrics:
                typer.echo(f"{stage.replace('_', ' ')}: {in_words(left_s)} left", err=True)

        made = train_setup(include(folder), SetupTrainingConfig(seed, queries, effort, randomise=randomise), told)
    say(
        {
            "setup": setup.name,
            "success_rate": made.success_rate,
            "success_interval": [round(bound, 4) for bound in made.interval],
            "begun_anew": made.begun_anew,
            "seconds": round(sum(made.seconds.values()), 1),
            "seconds_by_stage": made.seconds,
            "policies": made.policies,
            "query_sets": made.query_sets,
        },
        as_json,
    )


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
