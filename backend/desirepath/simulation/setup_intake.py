"""A setup that somebody brings as files or as one zip: bounded before it is read, put together, checked, looked at, and
only then put where setups are found.
"""

from __future__ import annotations

import io
import json
import math
import re
import secrets
import shutil
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import IO, Any, BinaryIO

from desirepath.grammar.source import Problem, ProtocolError
from desirepath.simulation import urdf
from desirepath.simulation.scene import SceneError
from desirepath.simulation.scenes import check_scene, draw_scenes, map_of
from desirepath.simulation.setup_files import check_setup, shipped_robots
from desirepath.simulation.setups import NAME, SETUP_FILE, Setup, SetupError, setup_folders
from desirepath.zip_files import BROKEN, files_in, open_zip

MOST_FILES = 200
LARGEST_FILE = 32 * 1024**2
LARGEST_ALL = 64 * 1024**2
CHECKED = "check.json"  # in a setup's folder: what was said when it was brought
SCENES = 20  # drawn to see whether a setup gives any
ENDINGS = (".yaml", ".yml", ".pgm", ".png", ".bmp", ".urdf", ".xacro", ".stl", ".dae", ".obj", ".mtl", ".glb", ".gltf")
_PART = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_. -]{0,79}")
PARTS = 4  # of a file's path: folders of meshes
WANTED = f"letters, digits, _ . - and at most {PARTS - 1} folders"


class IntakeError(ValueError):
    """What was brought cannot be a setup; says which file and what would work."""


def gather(uploads: Iterable[tuple[str, BinaryIO]]) -> dict[str, bytes]:
    """The files that are brought, those of their zips too, within one room for all. Raises IntakeError."""
    found: dict[str, bytes] = {}
    for name, file in uploads:
        room = LARGEST_ALL - sum(map(len, found.values()))
        if name.lower().endswith(".zip"):
            brought = unpack(name, file, room, MOST_FILES - len(found))
        else:
            brought = {name: _read(file, name, name, room)}
        if twice := found.keys() & brought.keys():
            raise IntakeError(f"{min(twice)}: is brought twice; take one of them out")
        found |= brought
    return found


def _read(file: IO[bytes], name: str, within: str, room: int) -> bytes:
    content = file.read(min(LARGEST_FILE, room) + 1)
    if len(content) > min(LARGEST_FILE, room):
        raise IntakeError(f"{within}: {name} makes it too large; {_most()}")
    return content


def unpack(name: str, content: BinaryIO, room: int = LARGEST_ALL, most: int = MOST_FILES) -> dict[str, bytes]:
    """The files of a zip, without the one folder that all of them may lie in. room, most: bytes and files that are
    taken. Raises IntakeError."""
    found: dict[str, bytes] = {}
    try:
        with open_zip(content) as packed:
            entries = files_in(packed)
            if len(entries) > most:
                raise IntakeError(f"{name}: holds {len(entries)} files; at most {MOST_FILES} are taken")
            for entry in entries:
                if entry.filename in found:
                    raise IntakeError(f"{name}: {entry.filename} is in it twice; take one of them out")
                with packed.open(entry) as file:
                    found[entry.filename] = _read(file, entry.filename, name, room)
                room -= len(found[entry.filename])
    except (*BROKEN, OSError) as problem:
        raise IntakeError(f"{name}: is no zip that can be read: {problem}") from None
    tops = {one.partition("/")[0] for one in found}
    if len(tops) == 1 and all("/" in one for one in found):
        found = {one.partition("/")[2]: held for one, held in found.items()}
    return found


def _most() -> str:
    return f"at most {LARGEST_FILE // 1024**2} MB a file and {LARGEST_ALL // 1024**2} MB in all are taken"


def take_in(name: str, files: Mapping[str, bytes], root: Path, robot: str = "") -> dict[str, Any]:
    """Put the files into `root/name`, whole or not at all, and say what is there. robot: of which shipped one the setup
    is, where the files have no `setup.yaml`. Files of other kinds are left out, and told. Raises IntakeError, or
    ProtocolError with every problem by file and line."""
    if not NAME.fullmatch(name):
        raise IntakeError(f"{name!r}: a setup's name is of lower-case letters, digits and _, beginning with a letter")
    if name in setup_folders():
        raise IntakeError(f"{name}: there is a setup of this name; take another, or remove it first")
    files = {path: held for path, held in files.items() if path != CHECKED}
    left_out = sorted(path[:100] for path in files if PurePosixPath(path).suffix.lower() not in ENDINGS)
    files = {path: held for path, held in files.items() if PurePosixPath(path).suffix.lower() in ENDINGS}
    _check_names(files)
    aside = root / f".incoming-{secrets.token_hex(8)}"
    folder = aside / name
    try:
        for path, content in files.items():
            place = folder / path
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(content)
        if SETUP_FILE not in files:
            (folder / SETUP_FILE).write_text(_setup_of(files, robot), encoding="utf-8")
        told = describe(check_setup(folder), folder) | ({"left_out": left_out} if left_out else {})
        (folder / CHECKED).write_text(json.dumps(told), encoding="utf-8")
        if (root / name).exists():
            raise IntakeError(f"{name}: somebody uploaded a setup of this name meanwhile; take another")
        folder.rename(root / name)
    except ProtocolError as wrong:
        raise ProtocolError([_shorter(problem, folder) for problem in wrong.problems]) from None
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return told


def _shorter(problem: Problem, folder: Path) -> Problem:
    """The problem with the file's name as it was brought."""
    return replace(problem, file=problem.file.replace(f"{folder}/", "").replace(f"{folder.resolve()}/", ""))


def _check_names(files: Mapping[str, bytes]) -> None:
    if not files:
        kinds = ", ".join(ENDINGS)
        raise IntakeError(f"no files: bring a setup.yaml, or a map.yaml with its picture; files taken are {kinds}")
    if len(files) > MOST_FILES:
        raise IntakeError(f"{len(files)} files; at most {MOST_FILES} are taken")
    if sum(map(len, files.values())) > LARGEST_ALL or max(map(len, files.values())) > LARGEST_FILE:
        raise IntakeError(f"too large; {_most()}")
    for path in files:
        parts = path.split("/")
        if len(parts) > PARTS or not all(_PART.fullmatch(part) for part in parts):
            raise IntakeError(f"{path[:100]!r}: is no name that is taken; {WANTED}")
    folders = {str(parent).lower() for path in files for parent in PurePosixPath(path).parents}
    if both := folders & {SETUP_FILE, *map(str.lower, files)}:
        raise IntakeError(f"{min(both)}: is the name of a file and of a folder; rename one")
    if len({path.lower() for path in files}) < len(files):
        raise IntakeError("two files have names that differ in capitals alone; rename one")


def _setup_of(files: Mapping[str, bytes], robot: str) -> str:
    """The `setup.yaml` of a map and a robot that are brought without one."""
    maps = [path for path, content in files.items() if path.endswith((".yaml", ".yml")) and b"image:" in content]
    robots = [path for path, content in files.items() if path.endswith((".yaml", ".yml")) and b"robot:" in content]
    if len(maps) != 1:
        found = ", ".join(maps) or "none"
        raise IntakeError(f"no {SETUP_FILE}, and not one map.yaml with an `image:` (found: {found}); bring one of both")
    for path in maps + robots:
        if "/" in path:
            raise IntakeError(f"{path}: lies in a folder; bring it, and what it names, beside the other files")
    driven = robot if robot in shipped_robots() else robots[0] if len(robots) == 1 else ""
    if not driven:
        raise IntakeError(f"no {SETUP_FILE} and no robot.yaml: choose one of {', '.join(shipped_robots())}")
    return f"robot: {driven}\nworld:\n  name: building\n  building:\n    map: {maps[0]}\n"


def describe(setup: Setup, folder: Path) -> dict[str, Any]:
    """What a setup's building has, and what scenes drawn in it are like. Raises ProtocolError for scenes that cannot be
    drawn, or not be driven in."""
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
            told["urdf"] = urdf.describe(urdf.read_looks(setup.robot.urdf))
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


def checked(folder: Path) -> dict[str, Any]:
    """What `take_in` said of that setup; nothing of one that was not brought here."""
    try:
        return dict(json.loads((folder / CHECKED).read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return {}


def add_left_out(folder: Path, left_out: list[str]) -> None:
    """Say of a setup that was brought what else of it was left out."""
    told = checked(folder)
    told["left_out"] = [*told.get("left_out", ()), *left_out]
    (folder / CHECKED).write_text(json.dumps(told), encoding="utf-8")


def take_out(name: str) -> bytes:
    """A zip of what is in a setup's folder: its description and what was trained there, not what is on its way."""
    folder = setup_folders()[name]
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as packed:
        for file in sorted(one for one in folder.rglob("*") if one.is_file()):
            within = file.relative_to(folder)
            if not within.parts[0].startswith("."):
                packed.write(file, f"{name}/{within.as_posix()}")
    return out.getvalue()


def remove(name: str, root: Path) -> None:
    """Take a setup that was brought here away with all that lies in its folder. Raises SetupError for another."""
    folder = root / name
    if not NAME.fullmatch(name) or not (folder / SETUP_FILE).is_file():
        raise SetupError(f"setup {name}: was not brought to this installation, so it is not removed here")
    aside = root / f".removed-{secrets.token_hex(8)}"
    folder.rename(aside)
    shutil.rmtree(aside, ignore_errors=True)
