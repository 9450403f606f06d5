"""A setup from above: its map, walls and furniture, and the starts, goals and people of some scenes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from desirepath.simulation.scenes import draw_scenes, map_of
from desirepath.simulation.setups import Setup

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCENES = 12


def draw_setup(setup: Setup) -> Figure:
    """Metres, in the building's frame. Raises SceneError."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Polygon

    figure = Figure(figsize=(5, 4), layout="constrained")
    ax = figure.add_subplot()
    here = map_of(setup)
    if here is not None:
        shades = 1.0 - 0.85 * here.occupied - 0.25 * (here.unknown & ~here.occupied)
        (x, y), (width, height) = here.origin, here.size_m
        ax.imshow(shades.T, origin="lower", extent=(x, x + width, y, y + height), cmap="gray", vmin=0, vmax=1)
    drawn = draw_scenes(setup, range(SCENES))
    for obstacle in drawn[0].obstacles if setup.plan else ():
        ax.add_patch(Polygon(obstacle.corners(), facecolor="#444" if obstacle.kind == "wall" else "#a08c6a"))
    for scene in drawn:
        start, goal, person = scene.start, scene.goal, scene.person.pose
        ax.plot((start.x, goal.x), (start.y, goal.y), "-", color="#1f6f4a", linewidth=0.8, alpha=0.6)
        ax.add_patch(Circle((start.x, start.y), setup.robot.radius_m, facecolor="#1f6f4a"))
        ax.add_patch(Circle((goal.x, goal.y), scene.goal_radius, fill=False, edgecolor="#1f6f4a"))
        if scene.has_person:
            ax.add_patch(Circle((person.x, person.y), scene.person.radius, facecolor="#b4532a"))
    xs = [place.x for scene in drawn for place in (scene.start, scene.goal)]
    ys = [place.y for scene in drawn for place in (scene.start, scene.goal)]
    ax.set(xlim=(min(xs) - 1.5, max(xs) + 1.5), ylim=(min(ys) - 1.5, max(ys) + 1.5))
    ax.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    return figure
