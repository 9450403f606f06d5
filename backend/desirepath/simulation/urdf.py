"""The picture of a robot in a URDF: what it looks like, as coloured triangles in the robot's frame, joints at zero.

Everything is bounded before it is parsed. Read are boxes, cylinders, spheres, and meshes in STL and OBJ that lie beside
the file; what a robot hits is its footprint (`setups.Robot`), not this.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, NoReturn
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from desirepath.grammar.source import Problem, ProtocolError

MOST_BYTES = 1024**2  # of the file
MOST_MESH_BYTES = 32 * 1024**2  # of all meshes
MOST_OBJ_LINES = 400_000  # of all meshes, as a line takes 10 microseconds
MOST_TRIANGLES = 100_000  # of all of it, as every page that shows the robot draws them
MOST_ELEMENTS, DEEPEST = 20_000, 32
FARTHEST_M = 5.0  # of anything from the robot's middle: as `setups.Robot` may be large
MESHES = (".stl", ".obj")
GREY = (128, 128, 128)

Colour = tuple[int, int, int]
Doubles = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Look:
    """One coloured part: triangles (n, 3, 3) float64, metres, x ahead, y to the left, z up from the floor."""

    triangles: Doubles
    colour: Colour


@dataclass(frozen=True)
class _Element:
    tag: str
    given: dict[str, str]
    line: int
    inside: list[_Element] = field(default_factory=list)

    def all(self, tag: str) -> list[_Element]:
        return [one for one in self.inside if one.tag == tag]

    def first(self, tag: str) -> _Element | None:
        return next(iter(self.all(tag)), None)


def read_looks(path: Path) -> list[Look]:
    """What the URDF shows. Raises ProtocolError with every problem: each missing mesh, by name and line."""
    return _Reader(path).looks()


def describe(looks: Sequence[Look]) -> dict[str, object]:
    """How much it shows, and how large that is: length, width and height, m."""
    corners = np.concatenate([look.triangles.reshape(-1, 3) for look in looks])
    size = [round(float(side), 3) for side in corners.max(axis=0) - corners.min(axis=0)]
    return {"parts": len(looks), "triangles": len(corners) // 3, "size_m": size}


def _parsed(path: Path) -> _Element:
    """The root element. Raises ProtocolError for what is too large, too deep, no XML, or has a document type, as
    entities have."""

    def refuse(line: int, message: str) -> NoReturn:
        raise ProtocolError([Problem(str(path), line, "(file)", None, message)])

    try:
        size = path.stat().st_size
        if size > MOST_BYTES:
            refuse(1, f"has {size:,} bytes; at most {MOST_BYTES:,} are read")
        text = path.read_bytes()
    except OSError as wrong:
        refuse(1, f"cannot be read: {wrong.strerror}")
    parser = expat.ParserCreate()
    root = _Element("", {}, 1)
    opened, count = [root], 0

    def start(tag: str, given: dict[str, str]) -> None:
        nonlocal count
        count += 1
        line = parser.CurrentLineNumber
        if count > MOST_ELEMENTS:
            refuse(line, f"has more than {MOST_ELEMENTS:,} elements")
        if len(opened) > DEEPEST:
            refuse(line, f"has more than {DEEPEST} elements within each other")
        opened.append(_Element(tag, given, line))
        opened[-2].inside.append(opened[-1])

    def no_type(*_: Any) -> NoReturn:
        refuse(parser.CurrentLineNumber, "has a document type; take it out: entities are not read")

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: opened.pop()
    parser.StartDoctypeDeclHandler = no_type
    try:
        parser.Parse(text, True)
    except (expat.ExpatError, ValueError, LookupError) as wrong:
        if isinstance(wrong, ProtocolError):
            raise
        refuse(parser.CurrentLineNumber, f"is not valid XML: {wrong}")
    return root.inside[0]


class _Reader:
    """One URDF: its problems are gathered, so that all of them are told at once."""

    def __init__(self, path: Path) -> None:
        self.path, self.folder = path, path.resolve().parent
        self.problems: list[Problem] = []
        self.left, self.bytes_left, self.lines_left = MOST_TRIANGLES, MOST_MESH_BYTES, MOST_OBJ_LINES
        self.meshes: dict[Path, Doubles] = {}
        self.root = _parsed(path)

    def wrong(self, element: _Element, where: str, value: object, message: str) -> None:
        self.problems.append(Problem(str(self.path), element.line, where, value, message))

    def looks(self) -> list[Look]:
        if self.root.tag != "robot":
            self.wrong(self.root, self.root.tag, None, "must be <robot>: this is no URDF")
            raise ProtocolError(self.problems)
        for element in self.root.inside:
            if element.tag.startswith("xacro:") and element.tag not in ("xacro:arg", "xacro:property"):
                self.wrong(element, element.tag, None, "must be filled in first: xacro FILE > robot.urdf")
        materials = {one.given.get("name", ""): colour for one in self.root.all("material") if (colour := _rgb(one))}
        places = self._places()
        parts = [
            look
            for link in self.root.all("link")
            if (place := places.get(link.given.get("name", ""))) is not None
            for visual in link.all("visual")
            if (look := self._look(visual, place, materials)) is not None
        ]
        if not parts and not self.problems:
            self.wrong(self.root, "robot", None, "shows nothing: none of its links has a <visual>")
        if not self.problems:
            self._check_size(parts)
        if self.problems:
            raise ProtocolError(self.problems)
        low = min(0.0, min(float(part.triangles[..., 2].min()) for part in parts))  # its root may be above the floor
        return [Look(part.triangles - [0.0, 0.0, low], part.colour) for part in parts]

    def _check_size(self, parts: list[Look]) -> None:
        farthest = max(float(np.abs(part.triangles).max()) for part in parts)
        if farthest > FARTHEST_M:
            message = f"reaches {farthest:,.1f} m from its middle, more than {FARTHEST_M:g} m; are its meshes in mm? "
            self.wrong(self.root, "robot", None, message + 'then give them scale="0.001 0.001 0.001"')

    def _places(self) -> dict[str, Doubles]:
        """Link -> (4, 4) from its frame to the root's, joints at zero."""
        names = [link.given.get("name", "") for link in self.root.all("link")]
        into: dict[str, list[tuple[str, Doubles]]] = {}
        children = set()
        for joint in self.root.all("joint"):
            parent, child = joint.first("parent"), joint.first("child")
            ends = [one.given.get("link", "") if one else "" for one in (parent, child)]
            for end in ends:
                if end not in names:
                    self.wrong(joint, f"joint {joint.given.get('name', '')}", end, "must join two of the links")
            if ends[1] in children:
                self.wrong(joint, f"joint {joint.given.get('name', '')}", ends[1], "is the child of another joint")
            children.add(ends[1])
            into.setdefault(ends[0], []).append((ends[1], self._origin(joint)))
        roots = [name for name in names if name not in children]
        if len(roots) != 1:
            self.wrong(self.root, "robot", ", ".join(roots) or None, "must have one link that is no joint's child")
            return {}
        places = {roots[0]: np.eye(4)}
        waiting = [roots[0]]
        while waiting:
            parent_name = waiting.pop()
            for child_name, step in into.get(parent_name, []):
                if child_name not in places:
                    places[child_name] = places[parent_name] @ step
                    waiting.append(child_name)
        for link in self.root.all("link"):
            if (name := link.given.get("name", "")) not in places:
                self.wrong(link, "link", name, f"must hang at {roots[0]!r} by joints, not at itself")
        return places

    def _numbers(self, element: _Element, key: str, default: tuple[float, ...], most: float = 1e4) -> Doubles:
        """The numbers of an attribute; the default for none, or for wrong ones."""
        written = element.given.get(key)
        if written is None:
            return np.array(default)
        try:
            values = [float(one) for one in written[:200].split()]
        except ValueError:
            values = []
        if len(values) != len(default) or not all(abs(value) <= most for value in values):  # NaN is no number either
            where = f"{element.tag} {key}"
            form = "a number" if len(default) == 1 else f"{len(default)} numbers"
            hint = "; fill it in with xacro" if "$" in written else ""
            self.wrong(element, where, written[:80], f"must be {form} within {most:g}{hint}")
            return np.array(default)
        return np.array(values)

    def _origin(self, element: _Element) -> Doubles:
        """(4, 4) of an element's <origin>: xyz in m, then roll, pitch and yaw about fixed axes."""
        place = np.eye(4)
        origin = element.first("origin")
        if origin is None:
            return place
        place[:3, 3] = self._numbers(origin, "xyz", (0.0, 0.0, 0.0))
        (cr, cp, cy), (sr, sp, sy) = (f(self._numbers(origin, "rpy", (0.0, 0.0, 0.0))) for f in (np.cos, np.sin))
        place[:3, :3] = [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
        return place

    def _look(self, visual: _Element, place: Doubles, materials: dict[str, Colour]) -> Look | None:
        geometry = visual.first("geometry")
        shape = geometry.inside[0] if geometry and geometry.inside else None
        if shape is None:
            self.wrong(visual, "visual", None, "needs a <geometry> with a shape in it")
            return None
        triangles = self._triangles(shape)
        if triangles is None:
            return None
        self.left -= len(triangles)
        if self.left < 0:
            self._too_many(shape, len(triangles))
        material = visual.first("material")
        colour = (_rgb(material) or materials.get(material.given.get("name", ""))) if material else None
        whole = place @ self._origin(visual)
        return Look(triangles @ whole[:3, :3].T + whole[:3, 3], colour or GREY)

    def _too_many(self, shape: _Element, count: int) -> NoReturn:
        """Nothing is read after this: what follows may be as large."""
        where = shape.given.get("filename", shape.tag)
        message = f"has {count:,} triangles; at most {MOST_TRIANGLES:,} are shown of a robot: decimate it"
        self.wrong(shape, "mesh", where, message)
        raise ProtocolError(self.problems)

    def _triangles(self, shape: _Element) -> Doubles | None:
        """(n, 3, 3) metres in the visual's frame; None for what cannot be read."""

        def size(key: str, count: int = 1) -> Doubles:
            return self._numbers(shape, key, (0.0,) * count, FARTHEST_M)

        if shape.tag == "mesh":
            return self._mesh(shape)
        if shape.tag == "box":
            sides = size("size", 3)
        elif shape.tag == "cylinder":
            sides = np.concatenate([size("radius"), size("radius"), size("length")])
        elif shape.tag == "sphere":
            sides = size("radius").repeat(3)
        else:
            self.wrong(shape, "geometry", shape.tag, "must be a box, cylinder, sphere or mesh")
            return None
        if not (sides > 0).all():
            self.wrong(shape, shape.tag, None, "must have sizes above 0 m")
            return None
        return _shape_of_one_metre(shape.tag) * sides

    def _mesh(self, shape: _Element) -> Doubles | None:
        named = shape.given.get("filename", "")
        scale = self._numbers(shape, "scale", (1.0, 1.0, 1.0))
        file = self._file(shape, named)
        if file is None:
            return None
        try:
            if file not in self.meshes:
                content = self._bounded(file)
                self.meshes[file] = _loaded(file, content)
        except _TooMany as many:
            self._too_many(shape, many.count)
        except (OSError, ValueError) as wrong:
            self.wrong(shape, "mesh", named[:200], str(wrong))
        else:
            return self.meshes[file] * scale
        return None

    def _file(self, shape: _Element, named: str) -> Path | None:
        """The mesh's file: below the URDF's folder, by the path that follows a package's name, or by its name alone."""
        inside = named.removeprefix("file://")
        if named.startswith("package://"):
            inside = "/".join(PurePosixPath(named.removeprefix("package://")).parts[1:])
        path = PurePosixPath(inside)
        if not inside or "\\" in inside or "\0" in inside or path.is_absolute() or ".." in path.parts or ":" in inside:
            self.wrong(shape, "mesh", named[:200], "must be the name of a file beside this one")
            return None
        if path.suffix.lower() not in MESHES:
            message = f"must be one of {', '.join(MESHES)}; convert it, in Blender for instance"
            self.wrong(shape, "mesh", named[:200], message)
            return None
        for candidate in (self.folder / path, self.folder / path.name):
            real = candidate.resolve()
            if real.is_file() and real.is_relative_to(self.folder):
                return real
        places = " or as ".join(dict.fromkeys([str(path), path.name]))
        self.wrong(shape, "mesh", named[:200], f"is missing: put it beside {self.path.name}, as {places}")
        return None

    def _bounded(self, file: Path) -> bytes:
        """A mesh's bytes. Raises _TooMany where it says that it has more triangles than are left, ValueError where
        it is too large or cut."""
        size = file.stat().st_size
        with file.open("rb") as opened:
            head = opened.read(84)
            binary = file.suffix.lower() == ".stl" and len(head) == 84
            said = int.from_bytes(head[80:], "little") if binary else 0
            if binary and size == 84 + 50 * said and said > self.left:
                raise _TooMany(said)
            self.bytes_left -= size
            if self.bytes_left < 0:
                raise ValueError(f"has {size:,} bytes; at most {MOST_MESH_BYTES:,} are read of all meshes: decimate it")
            content = head + opened.read(size)
        if file.suffix.lower() == ".obj":
            lines = content.splitlines()
            self.lines_left -= len(lines)
            if self.lines_left < 0:
                raise ValueError(f"has too many lines; at most {MOST_OBJ_LINES:,} are read of all meshes: decimate it")
            count = sum(max(len(line.split()) - 3, 0) for line in lines if line.startswith(b"f"))
        elif binary and size == 84 + 50 * said:
            count = said
        elif content.lstrip()[:5].lower() == b"solid":
            count = content.count(b"facet") // 2  # and its end
        else:
            raise ValueError(f"is cut: it says {said:,} triangles and has {size:,} bytes, not {84 + 50 * said:,}")
        if count > self.left:
            raise _TooMany(count)
        return content


class _TooMany(ValueError):
    def __init__(self, count: int) -> None:
        self.count = count


@cache
def _shape_of_one_metre(tag: str) -> Doubles:
    """(n, 3, 3) a box of that side; a cylinder or sphere of that radius, the cylinder as high."""
    import trimesh.creation  # half a second that only robots with a URDF need

    if tag == "box":
        made = trimesh.creation.box()
    elif tag == "cylinder":
        made = trimesh.creation.cylinder(radius=1, height=1, sections=24)
    else:
        made = trimesh.creation.icosphere(subdivisions=2)
    return np.asarray(made.triangles, dtype=np.float64)


def _loaded(file: Path, content: bytes) -> Doubles:
    """(n, 3, 3) of a mesh that is small enough. Raises ValueError for one that is none."""
    import trimesh

    try:
        mesh = trimesh.load_mesh(
            io.BytesIO(content), file_type=file.suffix.lower()[1:], process=False, skip_materials=True
        )
        triangles = np.asarray(mesh.triangles, dtype=np.float64).reshape(-1, 3, 3)
    except Exception as wrong:  # whatever a reader of files from outside stumbles over
        raise ValueError(f"is no mesh that can be read: {type(wrong).__name__}") from None
    if not len(triangles):
        raise ValueError("has no triangles")
    if not np.isfinite(triangles).all():
        raise ValueError("has corners that are no finite numbers")
    return triangles


def _rgb(material: _Element) -> Colour | None:
    """A material's own colour, 0 to 255."""
    colour = material.first("color")
    try:
        parts = [float(one) for one in colour.given.get("rgba", "").split()[:3]] if colour else []
    except ValueError:
        return None
    if len(parts) != 3 or not all(map(math.isfinite, parts)):
        return None
    red, green, blue = (round(255 * min(max(part, 0.0), 1.0)) for part in parts)
    return red, green, blue
