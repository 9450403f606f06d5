"""What people marked while trajectories played, in numbers and words: how often, why, and where. Pure."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from desirepath.analysis.intervals import end_at_scale
from desirepath.analysis.tested import Mean, mean_of
from desirepath.explain.printed import Section, Table
from desirepath.learning.preferences.marked_steps import REACTION_S
from desirepath.report.report_cells import NONE, interval_cell, name_in_words, number_words, share_words
from desirepath.report.study_data import Load, MarkedDrive
from desirepath.simulation.trajectory import Trajectory


@dataclass(frozen=True)
class OfMarking:
    """Under one condition: how many drives were watched; over people: share of them with a mark, marks per minute."""

    condition: str
    drives: int
    with_mark: Mean
    per_minute: Mean


@dataclass(frozen=True)
class OfReason:
    """Marks of one reason, "" where none was said, of all conditions; over people: how far into the drive they are, as
    a share of it, and how far the robot was from the nearest person then, metres."""

    why: str
    marks: int
    into: Mean
    distance_m: Mean


@dataclass(frozen=True)
class Marked:
    """usual_m: how far the robot is from the nearest person over the whole of the same drives, mean over people."""

    conditions: Sequence[OfMarking]
    reasons: Sequence[OfReason]
    usual_m: Mean


def describe_marks(drives: Sequence[MarkedDrive], load: Load) -> Marked | None:
    """None where nothing was watched to be marked."""
    if not drives:
        return None
    shown = {drive.trajectory: load(drive.trajectory) for drive in drives}
    lasts = {name: trajectory.duration_s for name, trajectory in shown.items()}
    apart = {name: _distances(trajectory) for name, trajectory in shown.items()}
    conditions: dict[str, dict[str, list[MarkedDrive]]] = defaultdict(lambda: defaultdict(list))
    where: dict[str, dict[str, list[tuple[float, float]]]] = defaultdict(lambda: defaultdict(list))
    usual: dict[str, list[float]] = defaultdict(list)
    for drive in drives:
        conditions[drive.condition][drive.person].append(drive)
        far, trajectory = apart[drive.trajectory], shown[drive.trajectory]
        usual[drive.person].append(float(far.mean()))
        for at_s, why in drive.marks:
            seen_s = max(0.0, at_s - REACTION_S)
            step = min(round(seen_s / trajectory.dt), len(far) - 1)
            where[why or ""][drive.person].append((seen_s / lasts[drive.trajectory], float(far[step])))
    return Marked(
        [_of_marking(name, of, lasts) for name, of in sorted(conditions.items())],
        [_of_reason(why, of) for why, of in sorted(where.items(), key=lambda one: -sum(map(len, one[1].values())))],
        mean_of([float(np.mean(of)) for of in usual.values()]),
    )


def _of_marking(name: str, by_person: dict[str, list[MarkedDrive]], lasts: dict[str, float]) -> OfMarking:
    shares = [float(np.mean([bool(drive.marks) for drive in of])) for of in by_person.values()]
    rates = [
        60 * sum(len(drive.marks) for drive in of) / sum(lasts[drive.trajectory] for drive in of)
        for of in by_person.values()
    ]
    drives = sum(map(len, by_person.values()))
    return OfMarking(name, drives, end_at_scale(mean_of(shares), 0.0, 1.0), mean_of(rates))


def _of_reason(why: str, by_person: dict[str, list[tuple[float, float]]]) -> OfReason:
    into, far = (mean_of([float(np.mean([at[k] for at in of])) for of in by_person.values()]) for k in (0, 1))
    return OfReason(why, sum(map(len, by_person.values())), into, far)


def _distances(trajectory: Trajectory) -> np.ndarray:
    """(n,) from the robot to the nearest person, NaN where nobody was recorded."""
    people = trajectory.scene.people_at(trajectory.times)
    if not len(people):
        return np.full(len(trajectory.poses), np.nan)
    nearest: np.ndarray = np.linalg.norm(people - trajectory.poses[:, :2], axis=2).min(axis=0)
    return nearest


def marks_section(marked: Marked | None) -> Section:
    """Empty where nothing was watched to be marked."""
    title = "Marked moments"
    if marked is None:
        return Section(title)
    often = [
        [
            name_in_words(of.condition),
            f"{of.drives:,}",
            share_words(of.with_mark),
            number_words(of.per_minute.mean, "{:.1f}"),
            interval_cell(of.per_minute.low, of.per_minute.high, "{:.1f}"),
        ]
        for of in marked.conditions
    ]
    reasons = [
        [
            name_in_words(of.why) or NONE,
            f"{of.marks:,}",
            str(of.into.n),
            number_words(100 * of.into.mean, "{:.0f} %"),
            number_words(of.distance_m.mean),
            interval_cell(of.distance_m.low, of.distance_m.high),
        ]
        for of in marked.reasons
    ]
    sentence = (
        f"Where the robot was {REACTION_S} s before the tap, means over people with 95 % intervals. Over the whole of "
        f"these drives it was {number_words(marked.usual_m.mean)} m from the nearest person. In the models every mark "
        "counts as the worst (good: the best) of its drive's parts; what was said of it counts nowhere but here."
    )
    tables = [
        Table(
            "How often moments were marked, over people.",
            ["condition", "drives", "with a mark, 95 % interval", "marks per minute", "95 %"],
            often,
        ),
        Table(
            "Why, and where.",
            ["why", "marks", "people", "into the drive", "metres to the nearest person", "95 %"],
            reasons,
        ),
    ]
    return Section(title, [sentence], [table for table in tables if table.rows])
