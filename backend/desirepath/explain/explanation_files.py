"""One trajectory explained, as files: a picture of the moment with the scores over time, and all scores as a table.

The numbers are `attribution.py`'s; how a scene is drawn is `scene_plots.py`'s.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from desirepath.explain.attribution import Actor, Explanation, explain
from desirepath.explain.flow_files import FigureFiles, table_bytes
from desirepath.explain.flow_words import ENGLISH_EXPLANATION, ExplanationWords
from desirepath.explain.methods import COMMANDS, AttributionError, Command, Method
from desirepath.explain.shown_explanation import people_of
from desirepath.explain.sight import Sight, sight_of, thing_names
from desirepath.simulation.acting import ActFunction, EpisodicPolicy
from desirepath.simulation.fast import rollout
from desirepath.simulation.scene import Scene
from desirepath.simulation.setups import get_setup
from desirepath.simulation.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Commands = NDArray[np.float64]
COLUMNS = ("step", "time_s", "x_m", "y_m", "yaw_rad", "command", "thing", "seen", "score", "attribution")
THICKEST_PT = 5.0  # outline of a thing with score 1, points
LEAST_CHANGE = 0.05  # ours: slower by less than this share of the speed range, and there is little to explain
NOTE = "the robot hardly slowed down here: little is explained"
NAMED_FROM = 0.02  # a thing that never scores more is not named in the picture
SHOWN_LINES = 5  # things with a line of their own in the chart; the others are in the table


def explanation_files(
    actor: Actor,
    act: ActFunction | EpisodicPolicy,
    scene: Scene,
    *,
    name: str,
    method: Method = "integrated_gradients",
    command: Command = "speed",
    at_s: float | None = None,
    words: ExplanationWords = ENGLISH_EXPLANATION,
) -> FigureFiles:
    """Let a policy drive a scene and explain it: explanation.png, .svg and .csv. actor: what `act` usually drives by.

    at_s: the moment of the picture, seconds; None: where the robot slowed down most, or turned most. Raises
    AttributionError for a moment outside the trajectory, SetupError for a policy without lidar.
    """
    trajectory = rollout(get_setup(scene.setup), act, [scene])[0]
    sight = sight_of(trajectory)
    explained = explain(actor, sight, method=method, command=command)
    scores = Scores(explained.things, explained.scores, method, command)

    def draw(ax: Axes, step: int) -> None:
        _draw_sight(ax, trajectory, sight, explained, step)

    signed = [_sign_scores(sight, explained, step) for step in range(len(trajectory.actions))]
    return _files(trajectory, scores, draw, signed, name, at_s, words)


def attended_files(
    trajectory: Trajectory,
    looked: NDArray[np.floating],
    *,
    name: str,
    command: Command = "speed",
    at_s: float | None = None,
    words: ExplanationWords = ENGLISH_EXPLANATION,
) -> FigureFiles:
    """The same files of a policy with attention: how much it looked at each of the scene's people, (steps, people)."""
    people = people_of(trajectory.scene)
    scores = Scores(people, looked, "attention", command)

    def draw(ax: Axes, step: int) -> None:
        _draw_people(ax, trajectory, scores, step)

    signed = [[(bool(score > 0), float(score)) for score in row] for row in looked]
    return _files(trajectory, scores, draw, signed, name, at_s, words)


@dataclass(frozen=True)
class Scores:
    """What is shown of a trajectory's T moments: scores (T, things) in [0, 1] of a command, by a method."""

    things: Sequence[str]
    scores: NDArray[np.floating]
    method: str
    command: Command


def _files(
    trajectory: Trajectory,
    explained: Scores,
    draw: Callable[[Axes, int], None],
    signed: Sequence[Sequence[tuple[bool, float]]],
    name: str,
    at_s: float | None,
    words: ExplanationWords,
) -> FigureFiles:
    """draw: the scene at a step. signed: by step and thing, whether it is seen, and its signed attribution."""
    from desirepath.explain.scene_plots import encode_figure  # matplotlib is slow to import

    scene, method, command = trajectory.scene, explained.method, explained.command
    step = moment(trajectory, command) if at_s is None else _step_at(trajectory, at_s)
    commands = command_of(trajectory, command)
    figure = _figure(trajectory, explained, draw, commands, step, name, words)
    slowest, fastest = reach(scene.setup, command)
    about = f"{method} of {name}'s {command}, {scene.setup} scene {scene.seed}, at {step * trajectory.dt:.1f} s"
    order = np.argsort(-explained.scores[step], kind="stable")
    numbers: dict[str, Any] = {
        "policy": name,
        "setup": scene.setup,
        "scene_seed": scene.seed,
        "method": method,
        "command": command,
        "outcome": trajectory.outcome.name.lower(),
        "at_s": round(step * trajectory.dt, 2),
        "command_at": round(float(commands[step]), 3),
        "command_before": round(float(commands[max(step - 1, 0)]), 3),
        "most_important": [
            {"thing": explained.things[k], "score": round(float(explained.scores[step, k]), 3)}
            for k in order
            if explained.scores[step, k] > 0
        ],
    }
    if command == "speed" and commands[max(step - 1, 0)] - commands[step] < LEAST_CHANGE * (fastest - slowest):
        numbers["note"] = NOTE
    files = {
        "explanation.png": encode_figure(figure, "png", about),
        "explanation.svg": encode_figure(figure, "svg", about),
        "explanation.csv": table_bytes(COLUMNS, _rows(trajectory, explained, signed, commands)),
    }
    return FigureFiles(files, numbers)


def reach(setup: str, command: Command) -> tuple[float, float]:
    """The command's range in that setup, m/s or rad/s."""
    limits = get_setup(setup).robot.limits
    return (limits.v_min, limits.v_max) if command == "speed" else (-limits.w_max, limits.w_max)


def command_of(trajectory: Trajectory, command: Command) -> Commands:
    """(T,) the command at each step, m/s or rad/s."""
    low, high = reach(trajectory.scene.setup, command)
    return low + (trajectory.actions[:, COMMANDS.index(command)].astype(np.float64) + 1) / 2 * (high - low)


def moment(trajectory: Trajectory, command: Command) -> int:
    """The step at which the robot slowed down most (speed), or turned fastest (turning)."""
    actions = trajectory.actions[:, COMMANDS.index(command)]
    if command == "turning" or len(actions) < 2:
        return int(np.abs(actions).argmax())
    return int(np.diff(actions).argmin()) + 1


def _step_at(trajectory: Trajectory, at_s: float) -> int:
    last = (len(trajectory.actions) - 1) * trajectory.dt
    if not 0 <= at_s <= last + 1e-9:
        raise AttributionError(f"at = {at_s} s: the trajectory has moments from 0 to {last:.1f} s")
    return round(at_s / trajectory.dt)


def _rows(
    trajectory: Trajectory, explained: Scores, of_steps: Sequence[Sequence[tuple[bool, float]]], commands: Commands
) -> Iterator[tuple[object, ...]]:
    """One row per moment and thing."""
    for step in range(len(trajectory.actions)):
        pose = [round(float(value), 4) for value in trajectory.poses[step]]
        at = (step, round(step * trajectory.dt, 2), *pose, round(float(commands[step]), 4))
        for k, (seen, signed) in enumerate(of_steps[step]):
            yield (*at, explained.things[k], seen, round(float(explained.scores[step, k]), 4), signed)


def _sign_scores(sight: Sight, explained: Explanation, step: int) -> list[tuple[bool, float]]:
    """By thing, whether it is seen, and the attribution, signed, of the ray or position with the greatest one."""
    rays, rows = explained.inputs[step, sight.first_ray :], list[tuple[bool, float]]()
    for k, thing in enumerate(explained.things):
        mine = [float(value) for value in rays[sight.provider[step] == k]]
        if thing == "goal":
            mine += explained.inputs[step, :2].tolist()
        elif thing == "person" and sight.setup.person_inputs is not None:
            mine += explained.inputs[step, list(sight.setup.person_inputs)].tolist()
        rows.append((thing == "goal" or bool(sight.seen[step, k]), max(mine, key=abs, default=0.0)))
    return rows


def _figure(
    trajectory: Trajectory,
    explained: Scores,
    draw: Callable[[Axes, int], None],
    commands: Commands,
    step: int,
    name: str,
    words: ExplanationWords,
) -> Figure:
    import matplotlib as mpl

    from desirepath.explain import scene_plots as plots
    from desirepath.explain.pictures import blank, quiet

    with mpl.rc_context(plots.STYLE):
        figure, (room, chart) = blank(2, 7.6, 3.6)
        draw(room, step)
        _draw_way(room, trajectory, step)
        _draw_names(room, trajectory, explained, step, words)
        room.set(xlabel=words.x, ylabel=words.y)
        room.set_title(f"{name}, {step * trajectory.dt:.1f} s")
        times = np.arange(len(commands)) * trajectory.dt
        quiet(chart)
        order = np.argsort(-explained.scores.max(axis=0), kind="stable")[:SHOWN_LINES]
        styles = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
        for k, colour, style in zip(order, plots.DATA, styles, strict=False):
            chart.plot(
                times, explained.scores[:, k], color=colour, linestyle=style, label=words.thing(explained.things[k])
            )
        chart.axvline(step * trajectory.dt, color=plots.INK, linewidth=0.8)
        chart.set(xlabel=words.time, ylabel=words.score, ylim=(-0.02, 1.05))
        twin = chart.twinx()
        twin.plot(times, commands, color=plots.LINE, linewidth=2.4, zorder=0)
        low, high = reach(trajectory.scene.setup, explained.command)
        twin.set(ylabel=getattr(words, explained.command), ylim=(low - 0.02 * (high - low), high + 0.05 * (high - low)))
        twin.spines["top"].set_visible(False)
        chart.set_zorder(twin.get_zorder() + 1)
        chart.patch.set_visible(False)
        chart.set_title(words.title.format(method=explained.method.replace("_", " "), command=explained.command))
        figure.legend(loc="outside lower center", ncols=SHOWN_LINES, frameon=False)
    return figure


def _draw_sight(ax: Axes, trajectory: Trajectory, sight: Sight, explained: Explanation, step: int) -> None:
    """The scene at that moment: pooled rays (free: thin, green), outlines by score."""
    from matplotlib.patches import Circle, Polygon

    from desirepath.explain import scene_plots as plots

    scene = trajectory.scene
    scores = dict(zip(explained.things, explained.scores[step], strict=True))
    plots.draw_solids(ax, scene)
    plots.draw_person(ax, scene)
    x, y, yaw = (float(value) for value in trajectory.poses[step])
    ranges, hit = sight.ranges[step].min(axis=0), sight.provider[step] >= 0
    for sector, middle in enumerate(sight.setup.robot.lidar.middles()):
        bearing = yaw + middle
        end = (x + ranges[sector] * math.cos(bearing), y + ranges[sector] * math.sin(bearing))
        colour, width = (plots.SECOND, 0.5) if hit[sector] else (plots.DATA[0], 0.25)
        ax.plot([x, end[0]], [y, end[1]], color=colour, linewidth=width, alpha=0.55, zorder=1)
    solids = scene.solids()
    for k, solid in enumerate(solids):
        width = THICKEST_PT * float(scores[sight.things[k]])
        if width > 0:
            ax.add_patch(Polygon(solid.corners(), fill=False, edgecolor=plots.INK, linewidth=width, zorder=5))
    person = scene.person_poses([step * trajectory.dt])[0]
    ring = scene.person.radius + 0.06
    ax.add_patch(
        Circle(
            (person[0], person[1]),
            ring,
            fill=False,
            edgecolor=plots.INK,
            linewidth=THICKEST_PT * scores["person"],
            zorder=7,
        )
    )
    goal = (scene.goal.x, scene.goal.y)
    ax.add_patch(
        Circle(
            goal,
            scene.goal_radius,
            fill=False,
            edgecolor=plots.DATA[0],
            linewidth=0.8 + THICKEST_PT * scores["goal"],
            zorder=6,
        )
    )


def _draw_people(ax: Axes, trajectory: Trajectory, explained: Scores, step: int) -> None:
    """The scene at that moment with its people, each in a ring by score."""
    from matplotlib.patches import Circle

    from desirepath.explain import scene_plots as plots

    scene = trajectory.scene
    plots.draw_solids(ax, scene)
    radius = scene.person.radius
    for (x, y), score in zip(scene.people_at([step * trajectory.dt])[:, 0], explained.scores[step], strict=True):
        ax.add_patch(Circle((x, y), radius, facecolor=plots.PERSON, linewidth=0, zorder=6))
        width = THICKEST_PT * float(score)
        ax.add_patch(Circle((x, y), radius + 0.06, fill=False, edgecolor=plots.INK, linewidth=width, zorder=7))
    goal = (scene.goal.x, scene.goal.y)
    ax.add_patch(Circle(goal, scene.goal_radius, fill=False, edgecolor=plots.DATA[0], linewidth=0.8, zorder=6))


def _draw_names(ax: Axes, trajectory: Trajectory, explained: Scores, step: int, words: ExplanationWords) -> None:
    """What chart and table call the things that the policy went by, beside each."""
    from matplotlib.patheffects import withStroke

    from desirepath.explain import scene_plots as plots

    scene = trajectory.scene
    places = {
        name: (solid.pose.x, solid.pose.y) for name, solid in zip(thing_names(scene), scene.obstacles, strict=False)
    }
    people = scene.people_at([step * trajectory.dt])[:, 0]
    places |= {name: (float(x), float(y)) for name, (x, y) in zip(people_of(scene), people, strict=False)}
    for thing, most in zip(explained.things, explained.scores.max(axis=0), strict=True):
        if thing in places and most > NAMED_FROM:
            ax.annotate(
                words.thing(thing),
                places[thing],
                (0, 3),
                textcoords="offset points",
                fontsize=6,
                ha="center",
                va="bottom",
                zorder=9,
                path_effects=[withStroke(linewidth=2, foreground=plots.PAPER)],
            )


def _draw_way(ax: Axes, trajectory: Trajectory, step: int) -> None:
    """The robot, its path so far and to come."""
    from matplotlib.patches import Circle

    from desirepath.explain import scene_plots as plots
    from desirepath.explain.flow_field import grid_of

    scene, (x, y) = trajectory.scene, trajectory.poses[step, :2]
    path = trajectory.poses
    ax.plot(path[: step + 1, 0], path[: step + 1, 1], color=plots.FIRST, linewidth=1.6, zorder=4)
    ax.plot(path[step:, 0], path[step:, 1], color=plots.FIRST, linewidth=0.8, linestyle="--", zorder=4)
    ax.add_patch(Circle((x, y), get_setup(scene.setup).robot.radius_m, facecolor=plots.FIRST, linewidth=0, zorder=7))
    left, right, bottom, top = grid_of(scene).extent
    ax.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
