"""A recording to try the page of recordings with: two runs of a simulated robot in one place, as a table."""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.csv_text import csv_text
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.artefacts import ArtefactError, ArtefactStore, load_trajectory
from desirepath.store.models import Artefact
from desirepath.store.query_sets import queries_of
from desirepath.store.shipped_policies import came_with_product

NAME = "example_simulated.csv"
HEADS = ("run", "who", "kind", "time_s", "x_m", "y_m", "yaw_rad", "length_m", "width_m")


def example_recording(s: DatabaseSession, files: ArtefactStore) -> str | None:
    """CSV of the first pair of a query set that came with the product; None where none is here yet."""
    sets = s.scalars(select(Artefact).where(Artefact.kind == "query_set").order_by(Artefact.created_at))
    for query_set in sets:
        if not came_with_product(query_set.id):
            continue
        try:
            query = queries_of(s, files, query_set.id, whole=False)[0]
            runs = {
                "first": load_trajectory(files, query.trajectory_a),
                "second": load_trajectory(files, query.trajectory_b),
            }
        except ArtefactError:
            continue
        rows = [row for name, run in runs.items() for row in _rows(name, run)]
        return csv_text([list(HEADS), *rows])
    return None


def _rows(run: str, driven: Trajectory) -> list[list[object]]:
    """A line per pose of the robot, and one each for person, goal and furniture at the run's beginning."""
    scene, none = driven.scene, ""
    rows: list[list[object]] = [
        [run, "robot", "robot", round(float(time), 2), *(round(float(value), 3) for value in pose), none, none]
        for time, pose in zip(driven.times, driven.poses, strict=True)
    ]
    end = rows[-1][3]
    if scene.has_person:
        at = scene.person.pose
        rows += [
            [run, "person", "person", time, round(at.x, 3), round(at.y, 3), round(at.yaw, 3), none, none]
            for time in (0, end)
        ]
    rows.append([run, "goal", "goal", 0, round(scene.goal.x, 3), round(scene.goal.y, 3), none, none, none])
    for number, solid in enumerate(scene.obstacles, start=1):
        at = solid.pose
        place = [round(value, 3) for value in (at.x, at.y, at.yaw, solid.length, solid.width)]
        rows.append([run, f"{solid.kind} {number}", "obstacle", 0, *place])
    return rows
