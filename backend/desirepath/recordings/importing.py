"""From a path to a query set: which files there are, of which format, and what becomes of them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Literal

from desirepath.learning.queries.queries import QuerySet
from desirepath.recordings import bags, csv_tables, episodes, socnav3, videos
from desirepath.recordings.conversion import Converted, convert
from desirepath.recordings.mapping import Mapping, Run
from desirepath.recordings.pairs import given_pairs, propose_pairs
from desirepath.recordings.recording import BOUNDS, Bounds, Goal, Recording, RecordingError, Track
from desirepath.simulation.setups import Setup, get_setup

MOST_IN_ALL = 2_000  # people in a recording that is cut into runs

Pairs = Literal["given", "proposed"]
Reader = Callable[[Path, Mapping, Bounds], list[Recording]]
READERS: dict[str, Reader] = {
    csv_tables.FORMAT: csv_tables.read_csv,
    socnav3.FORMAT: socnav3.read_socnav3,
    bags.MCAP: bags.read_bag,
    bags.ROSBAG2: bags.read_bag,
    episodes.MINARI: episodes.read_minari,
    episodes.LEROBOT: episodes.read_lerobot,
}
"""Of one file or, where a recording is a folder, of that; by format."""
SUFFIXES = {".csv": csv_tables.FORMAT, ".json": socnav3.FORMAT, **bags.SUFFIXES}
"""Of files that tell where a robot was; what films it is in `videos.MEDIA`."""


@dataclass(frozen=True)
class Imported:
    """A query set of recordings. lineage: file, format and sha256 of all that it was made from. answers: where some
    were given, each with which of the set's queries it is about. videos: the files that are shown."""

    query_set: QuerySet
    scenes: int
    trajectories: int
    warnings: tuple[str, ...]
    lineage: tuple[dict[str, str], ...]
    videos: tuple[Path, ...] = ()
    answers: tuple[tuple[int, csv_tables.GivenAnswer], ...] = ()

    def recorded_card(self) -> dict[str, Any]:
        """What the set's card says of where it is from."""
        return {"files": list(self.lineage), "warnings": list(self.warnings)}


def import_recordings(
    path: Path,
    setup: str,
    mapping: Mapping | None = None,
    mapping_file: tuple[str, str] | None = None,
    *,
    pairs: Pairs | None = None,
    most: int = 200,
    answers: Path | None = None,
    bounds: Bounds = BOUNDS,
) -> Imported:
    """Read all recordings at `path`, a file or a folder of them. mapping_file: its name and sha256. pairs: default
    those that are given, where any are. most: pairs that are proposed. answers: a CSV (a, b, choice, person); its pairs
    are the queries.

    Raises RecordingError, SetupError for an unknown setup or one whose measures need what no recording has.
    """
    mapping = mapping or Mapping()
    of = get_setup(setup)
    if of.pedestrians or of.solids:
        raise RecordingError(
            path.name, "setup", setup, "judges by what its robot was told, which is not recorded; use study_room"
        )
    files, pair_file = find_files(path, mapping, bounds, answers)
    # What `runs` cuts apart may have pauses and more people in all: each piece is judged when it is converted.
    loose = replace(bounds, gap_s=math.inf, people=MOST_IN_ALL) if mapping.runs else bounds
    films = name_videos([file for file, kind in files if kind == videos.FORMAT], path)
    read = [(file, kind) for file, kind in files if kind != videos.FORMAT]
    recordings = [one for file, kind in read for one in _pieces(READERS[kind](file, mapping, loose), mapping)]
    if len(recordings) > bounds.runs:
        raise RecordingError(path.name, "runs", len(recordings), f"at most {bounds.runs} are read")
    recordings = [_placed(one, mapping) for one in recordings]
    converted = [convert(one, of, bounds) for one in recordings]
    listed = csv_tables.read_pairs(pair_file, bounds) if pair_file else []
    if films:
        converted = _filmed(films, listed, converted, of, pair_file.name if pair_file else path.name, bounds)
    given, answers_sha = csv_tables.read_answers(answers, bounds) if answers is not None else ([], "")
    named = [*mapping.pairs, *(one.names for one in listed)]
    if answers is not None:
        pair_file, pairs, named = answers, "given", list(dict.fromkeys((one.a, one.b) for one in given))
    if films and (pairs == "proposed" or not named):
        problem = "videos are not proposed: pairs.csv (a, b) beside them names the files of each pair"
        raise RecordingError(path.name, "pairs", None, problem)
    if pairs == "given" and not named:
        raise RecordingError(
            path.name, "pairs", None, "none are given; a file pairs.csv (a, b) or `pairs` in the mapping"
        )
    if named and pairs != "proposed":
        queries, filtered = given_pairs(pair_file.name if pair_file else "mapping", converted, named), {}
    else:
        proposed = propose_pairs(converted, most)
        queries, filtered = proposed.queries, proposed.filtered
    if not queries:
        scenes = len({one.scene for one in converted})
        problem = f"no pair to show: {len(converted)} runs in {scenes} scenes"
        if scenes > 1:
            problem += "; `scene: lab` in the mapping (on the page under More) says that all are of one place"
        raise RecordingError(
            path.name, "pairs", filtered or None, f"{problem}; two runs of one scene that differ are needed"
        )
    sources = {(one.source.file, one.source.format, one.source.sha256) for one in recordings}
    for one in converted if films else ():
        if (made := one.trajectory.recorded) is not None and made.video is not None:
            sources.add((made.run, videos.FORMAT, made.video.sha256))
    lineage = [dict(zip(("file", "format", "sha256"), source, strict=True)) for source in sorted(sources)]
    if mapping_file is not None:
        lineage.append({"file": mapping_file[0], "format": "mapping", "sha256": mapping_file[1]})
    if answers is not None:
        lineage.append({"file": answers.name, "format": "answers", "sha256": answers_sha})
    place = {pair: number for number, pair in enumerate(named)}
    return Imported(
        answers=tuple((place[one.a, one.b], one) for one in given),
        query_set=QuerySet(setup, queries, filtered),
        scenes=len({one.scene for one in converted}),
        trajectories=len(converted),
        warnings=tuple(dict.fromkeys(warning for one in converted for warning in one.warnings)),
        lineage=tuple(lineage),
        videos=tuple(films.values()),
    )


def find_files(
    path: Path, mapping: Mapping, bounds: Bounds, answers: Path | None = None
) -> tuple[list[tuple[Path, str]], Path | None]:
    """The recordings with their formats, in order, and the list of pairs that lies with them; `answers` is neither."""
    if not path.exists():
        raise RecordingError(str(path), "", None, "there is no such file or folder")
    if path.is_file():
        return [(path, _format_of(path, mapping, path))], None
    if (kind := _folder_format(path)) is not None:
        return [(path, kind)], None
    there = (one for one in path.rglob("*") if one.is_file() and not one.name.startswith("."))
    inside = sorted(islice(there, bounds.files + 1))
    if len(inside) > bounds.files:
        raise RecordingError(path.name, "files", len(inside), f"more than {bounds.files} files; import parts of it")
    pair_file = next((one for one in inside if csv_tables.is_pairs(one)), None)
    whole: dict[Path, str] = {}
    for folder in sorted({folder for one in inside for folder in one.parents if path in folder.parents}):
        if not any(outer in whole for outer in folder.parents) and (kind := _folder_format(folder)):
            whole[folder] = kind
    lies_in = {one: any(folder in whole for folder in one.parents) for one in inside}
    apart = {pair_file, *(one for one in inside if answers is not None and one.samefile(answers))}
    taken = [one for one in inside if one.suffix.lower() in SUFFIXES and one not in apart and not lies_in[one]]
    apart.update(*(folder.rglob("*") for folder in whole))
    taken += [one for one in inside if videos.is_video(one) and one not in apart]
    taken = sorted([*taken, *whole])
    if not taken:
        found = sorted({one.suffix for one in inside})[:10]
        raise RecordingError(path.name, "files", found, f"no recording in it; read are {', '.join(sorted(SUFFIXES))}")
    if (total := sum(one.stat().st_size for one in inside)) > bounds.all_bytes:
        raise RecordingError(path.name, "bytes", total, f"at most {bounds.all_bytes} are read; import parts of it")
    return [(one, whole.get(one) or _format_of(one, mapping, path)) for one in taken], pair_file


def name_videos(files: Sequence[Path], folder: Path) -> dict[str, Path]:
    """What pairs call each: its file's name, or, where several have that, its path below the folder."""
    several = {name for name, count in Counter(file.name for file in files).items() if count > 1}
    return {file.relative_to(folder).as_posix() if file.name in several else file.name: file for file in files}


def _folder_format(folder: Path) -> str | None:
    """The format of a folder that is one recording or data set as a whole."""
    if (folder / bags.METADATA).is_file() and bags.bag_files(folder):
        return bags.ROSBAG2
    return episodes.kind_of(folder)


def _format_of(file: Path, mapping: Mapping, path: Path) -> str:
    if videos.is_video(file):
        return videos.FORMAT
    found = mapping.format or SUFFIXES.get(file.suffix.lower())
    if found is None:
        raise RecordingError(path.name, "format", file.suffix, f"unknown; read are {', '.join(sorted(SUFFIXES))}")
    return found


def _filmed(
    films: dict[str, Path],
    listed: Sequence[csv_tables.GivenPair],
    runs: Sequence[Converted],
    setup: Setup,
    pair_file: str,
    bounds: Bounds,
) -> list[Converted]:
    """A run per video, named as its file; with its poses where the list of pairs names a run that has them."""
    by_name = {one.trajectory.recorded.run: one for one in runs if one.trajectory.recorded}
    about: dict[str, tuple[str, float | None]] = {}
    for number, pair in enumerate(listed, start=1):
        for name, poses, seconds in zip(pair.names, pair.poses, pair.seconds, strict=True):
            if poses and poses not in by_name:
                known = ", ".join(list(by_name)[:20]) or "none"
                raise RecordingError(
                    pair_file, f"pair {number}, poses", poses, f"no run of that name; there are {known}"
                )
            before = about.get(name, ("", None))
            about[name] = (poses or before[0], before[1] if seconds is None else seconds)
    found = []
    for name, file in films.items():
        poses, seconds = about.get(name, ("", None))
        video = videos.read_video(file, seconds, bounds)
        if poses:
            run = by_name[poses]
            shown = videos.with_video(run.trajectory, name, video)
            found.append(replace(run, trajectory=shown))
        else:
            found.append(Converted(videos.of_video(name, name, video, setup), "videos", ()))
    return found


def _pieces(recordings: Sequence[Recording], mapping: Mapping) -> list[Recording]:
    """The runs that the mapping cuts out of these of one file; all as they are where it names none of this file."""
    file = recordings[0].source.file if recordings else ""
    wanted = [run for run in mapping.runs if run.file in (None, file)]
    if not wanted:
        return list(recordings)
    if len(recordings) > 1:
        raise RecordingError(file, "mapping, runs", None, f"cuts files of one run; this has {len(recordings)}")
    return [_piece(recordings[0], run) for run in wanted]


def _piece(whole: Recording, run: Run) -> Recording:
    times = whole.robot.times_s
    first, last = times[0] + run.from_s, times[-1] if run.to_s is None else times[0] + run.to_s
    inside = (times >= first - 1e-9) & (times <= last + 1e-9)
    if inside.sum() < 2:
        span = f"the file has {times[-1] - times[0]:.6g} s from its first pose on"
        raise RecordingError(
            whole.source.file, f"mapping, run {run.name!r}", [run.from_s, run.to_s], f"holds no poses: {span}"
        )
    robot = Track(times[inside], whole.robot.poses[inside])
    people = {}
    for who, seen in whole.people.items():
        here = (seen.times_s >= first - 1.0) & (seen.times_s <= last + 1.0)
        if here.any():
            people[who] = Track(seen.times_s[here], seen.poses[here])
    goal = Goal(run.goal.x, run.goal.y, radius=run.goal.radius_m) if run.goal else whole.goal
    return replace(whole, run=run.name, scene=run.scene or whole.scene, robot=robot, people=people, goal=goal)


def _placed(one: Recording, mapping: Mapping) -> Recording:
    """With the scene and the goal that the mapping says of all."""
    goal = mapping.goal
    if goal is not None and one.goal is None:
        one = replace(one, goal=Goal(goal.x, goal.y, radius=goal.radius_m))
    return replace(one, scene=mapping.scene or one.scene)
