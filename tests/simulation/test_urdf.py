"""A robot's URDF: read with its meshes, and everything that is not one refused before it is loaded."""

from __future__ import annotations

import math
import re
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from desirepath.grammar.source import ProtocolError
from desirepath.simulation import urdf
from desirepath.simulation.setup_files import read_robot
from desirepath.simulation.urdf import MOST_BYTES, describe, read_looks

ROBOT = """\
<?xml version="1.0"?>
<robot name="own" xmlns:xacro="http://ros.org/wiki/xacro">
  <xacro:arg name="namespace" default=""/>
  <material name="red"><color rgba="1 0 0 1"/></material>
  <link name="${namespace}base"/>
  <joint name="up" type="fixed">
    <parent link="${namespace}base"/><child link="body"/><origin xyz="0.1 0 0.2" rpy="0 0 1.5707963267948966"/>
  </joint>
  <link name="body"><visual>
    <origin xyz="0.05 0 0"/><geometry>SHAPE</geometry><material name="red"/>
  </visual></link>
</robot>
"""
BOX = '<box size="0.4 0.2 0.1"/>'
MESH = '<mesh filename="package://own_description/meshes/body.stl" scale="0.001 0.001 0.001"/>'


def written(folder: Path, shape: str = BOX, text: str = ROBOT) -> Path:
    (folder / "own.urdf").write_text(text.replace("SHAPE", shape))
    return folder / "own.urdf"


def problems(path: Path) -> list[str]:
    with pytest.raises(ProtocolError) as caught:
        read_looks(path)
    return [str(problem) for problem in caught.value.problems]


def stl(folder: Path, name: str = "body.stl", **change: object) -> Path:
    mesh = trimesh.creation.box(extents=[400, 200, 100])
    mesh.export(folder / name, **change)
    return folder / name


def test_parts_stand_where_the_joints_put_them_in_their_colour(tmp_path):
    (look,) = read_looks(written(tmp_path))
    assert look.colour == (255, 0, 0)
    corners = look.triangles.reshape(-1, 3)
    # turned by a quarter: its length lies across, and the visual's own 5 cm ahead are 5 cm to the left
    assert corners.min(axis=0) == pytest.approx([0.0, -0.15, 0.15])
    assert corners.max(axis=0) == pytest.approx([0.2, 0.25, 0.25])
    assert describe([look]) == {"parts": 1, "triangles": 12, "size_m": [0.2, 0.4, 0.1]}


@pytest.mark.parametrize(
    ("shape", "size"),
    [('<cylinder radius="0.1" length="0.3"/>', [0.2, 0.2, 0.3]), ('<sphere radius="0.1"/>', [0.2, 0.2, 0.2])],
)
def test_cylinders_and_spheres_are_shown(tmp_path, shape, size):
    assert describe(read_looks(written(tmp_path, shape)))["size_m"] == pytest.approx(size, abs=0.002)


@pytest.mark.parametrize("where", ["meshes/body.stl", "body.stl"])
@pytest.mark.parametrize("form", ["stl", "stl_ascii"])
def test_meshes_are_found_by_their_path_in_the_package_or_their_name(tmp_path, where, form):
    (tmp_path / "meshes").mkdir()
    stl(tmp_path, where, file_type=form)
    assert describe(read_looks(written(tmp_path, MESH)))["size_m"] == [0.2, 0.4, 0.1]


def test_an_obj_with_faces_of_four_corners_is_cut_into_triangles(tmp_path):
    corners = [(x, y, z) for x in (0, 0.1) for y in (0, 0.2) for z in (0, 0.3)]
    faces = [(1, 2, 4, 3), (5, 6, 8, 7), (1, 2, 6, 5), (3, 4, 8, 7), (1, 3, 7, 5), (2, 4, 8, 6)]
    lines = ["mtllib /etc/passwd", *(f"v {x} {y} {z}" for x, y, z in corners), "usemtl gone"]
    (tmp_path / "body.obj").write_text("\n".join([*lines, *("f " + " ".join(map(str, face)) for face in faces)]))
    told = describe(read_looks(written(tmp_path, '<mesh filename="body.obj"/>')))
    assert (told["triangles"], told["size_m"]) == (12, [0.2, 0.1, 0.3])


def test_a_robot_whose_root_is_above_the_floor_stands_on_it(tmp_path):
    low = min(float(look.triangles[..., 2].min()) for look in read_looks(written(tmp_path, '<sphere radius="0.5"/>')))
    assert low == pytest.approx(0.0, abs=1e-9)


def test_each_missing_mesh_is_named_with_where_it_may_lie(tmp_path):
    text = ROBOT.replace("</robot>", f'<link name="x"><visual><geometry>{MESH}</geometry></visual></link></robot>')
    text = text.replace('<child link="body"/>', '<child link="body"/>').replace(
        '<link name="x">', '<joint name="j"><parent link="body"/><child link="x"/></joint><link name="x">'
    )
    told = problems(written(tmp_path, '<mesh filename="a/b.obj"/>', text))
    assert [one.split("own.urdf:")[1].split(":")[0] for one in told] == ["10", "12"]
    assert "mesh = 'a/b.obj': is missing: put it beside own.urdf, as a/b.obj or as b.obj" in told[0]
    assert "as meshes/body.stl or as body.stl" in told[1]


@pytest.mark.parametrize(
    "named",
    [
        "../secret.stl", "/etc/secret.stl", "package://x/../../secret.stl", "a/../../secret.stl", "file:///etc/x.stl",
        "http://evil/x.stl", "C:\\\\x.stl", "", "package://", "//host/x.stl",
    ],
)  # fmt: skip
def test_meshes_elsewhere_are_refused_even_where_they_exist(tmp_path, named):
    stl(tmp_path, "secret.stl")
    (tmp_path / "robot").mkdir()
    (told,) = problems(written(tmp_path / "robot", f'<mesh filename="{named}"/>'))
    assert "must be the name of a file beside this one" in told


def test_a_link_that_leads_out_of_the_folder_is_refused(tmp_path):
    outside = stl(tmp_path, "secret.stl")
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "body.stl").symlink_to(outside)
    (told,) = problems(written(tmp_path / "robot", '<mesh filename="body.stl"/>'))
    assert "is missing" in told


@pytest.mark.parametrize("named", ["body.dae", "body.glb", "body.ply", "body.stl.gz", "body"])
def test_other_formats_are_refused_with_what_would_work(tmp_path, named):
    (tmp_path / named).write_bytes(b"x")
    (told,) = problems(written(tmp_path, f'<mesh filename="{named}"/>'))
    assert "must be one of .stl, .obj; convert it" in told


def test_ten_million_triangles_are_refused_by_the_header_alone(tmp_path, monkeypatch):
    count = 10_000_000
    with (tmp_path / "body.stl").open("wb") as file:  # 500 MB that are nowhere: a hole in the file
        file.write(b"\0" * 80 + struct.pack("<I", count))
        file.truncate(84 + 50 * count)
    monkeypatch.setattr(urdf, "_loaded", lambda *_: pytest.fail("it was loaded"))
    (told,) = problems(written(tmp_path, MESH))
    assert "has 10,000,000 triangles; at most 100,000 are shown of a robot" in told


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"\0" * 80 + struct.pack("<I", 10_000_000) + b"\0" * 100, "is cut: it says 10,000,000 triangles"),
        (b"\0" * 80 + struct.pack("<I", 12) + b"\0" * 599, "is cut: it says 12 triangles and has 683 bytes, not 684"),
        (b"\0" * 80 + struct.pack("<I", 0), "has no triangles|is no mesh"),
        (b"", "is cut"),
        (b"solid x\nfacet normal", "is no mesh|has no triangles"),
        (b"solid x\n" + b"facet endfacet\n" * 100_001, "has 100,001 triangles"),
        (b"\0" * 80 + struct.pack("<I12fH", 1, *[math.nan] * 12, 0), "has corners that are no finite numbers"),
        (b"\0" * 80 + struct.pack("<I12fH", 1, *[1e9] * 12, 0), "reaches 1,000,000.* in mm"),
    ],
)
def test_a_mesh_that_is_none_is_refused(tmp_path, content, problem):
    (tmp_path / "body.stl").write_bytes(content)
    (told,) = problems(written(tmp_path, MESH))
    assert re.search(problem, told), told


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("v 0 0 0\n" * 3 + "f 1 2 3\n" * 100_001, "has 100,001 triangles"),
        ("v 0 0 0\n" * 3 + "f " + "1 " * 100_010, "has 100,008 triangles"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 999\n", "is no mesh that can be read|has no triangles"),
        ("nothing at all", "is no mesh that can be read|has no triangles"),
        ("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "no finite numbers|is no mesh"),
    ],
)
def test_an_obj_that_is_none_is_refused(tmp_path, content, problem):
    (tmp_path / "body.obj").write_text(content)
    (told,) = problems(written(tmp_path, '<mesh filename="body.obj"/>'))
    assert re.search(problem, told), told


def test_triangles_are_counted_over_all_meshes(tmp_path, monkeypatch):
    monkeypatch.setattr(urdf, "MOST_TRIANGLES", 20)
    stl(tmp_path)
    two = f"{MESH}</geometry></visual><visual><geometry>{MESH}"
    assert "has 12 triangles; at most 20 are shown" in problems(written(tmp_path, two))[0]


def test_a_mesh_larger_than_any_is_refused_unread(tmp_path):
    with (tmp_path / "body.obj").open("wb") as file:
        file.truncate(200 * 1024**2)
    (told,) = problems(written(tmp_path, '<mesh filename="body.obj"/>'))
    assert "has 209,715,200 bytes; at most 33,554,432 are read" in told


BOMB = '<!DOCTYPE robot [<!ENTITY a "aaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]><robot name="&b;"/>'
OUTSIDE = '<!DOCTYPE robot [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="x"><link name="&a;"/></robot>'


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (BOMB, "has a document type; take it out"),
        (OUTSIDE, "has a document type; take it out"),
        ("<robot>" * 40, "more than 32 elements within each other"),
        ("<robot>" + "<link/>" * 20_001, "more than 20,000 elements"),
        ("<robot><link></robot>", "is not valid XML: mismatched tag"),
        ("", "is not valid XML"),
        ("\0\0", "is not valid XML"),
        ('<?xml version="1.0" encoding="no-such"?><robot/>', "is not valid XML"),
        ("<sdf/>", "must be <robot>: this is no URDF"),
        ("<robot/>", "must have one link that is no joint's child"),
        ('<robot><link name="a"/></robot>', "shows nothing"),
        ('<robot><link name="a"/><link name="b"/></robot>', "must have one link that is no joint's child"),
        (ROBOT.replace('<child link="body"/>', '<child link="gone"/>'), "'gone': must join two of the links"),
        (ROBOT.replace('<parent link="${namespace}base"/>', '<parent link="body"/>'), "'body': must hang at"),
        (ROBOT.replace('xyz="0.1 0 0.2"', 'xyz="nan 0 0"'), "must be 3 numbers within 10000"),
        (ROBOT.replace('xyz="0.1 0 0.2"', 'xyz="${x} 0 0"'), "fill it in with xacro"),
        (ROBOT.replace("<xacro:arg", "<xacro:wheel"), "must be filled in first: xacro FILE"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_urdf_is_refused(tmp_path, text, problem):
    assert problem in "; ".join(problems(written(tmp_path, BOX, text)))


@pytest.mark.parametrize(
    ("shape", "problem"),
    [
        ('<box size="0.4 0.2"/>', "box size = '0.4 0.2': must be 3 numbers"),
        ('<box size="0.4 0.2 -1"/>', "must have sizes above 0 m"),
        ('<box size="1e999 1 1"/>', "must be 3 numbers within 5"),
        ('<sphere radius="x"/>', "sphere radius = 'x': must be a number within 5"),
        ('<torus radius="1"/>', "must be a box, cylinder, sphere or mesh"),
        ("", "needs a <geometry> with a shape in it"),
    ],
)
def test_a_shape_that_is_none_is_refused(tmp_path, shape, problem):
    assert problem in "; ".join(problems(written(tmp_path, shape)))


def test_meshes_in_millimetres_without_a_scale_are_said_to_be(tmp_path):
    stl(tmp_path)
    assert 'scale="0.001 0.001 0.001"' in problems(written(tmp_path, '<mesh filename="body.stl"/>'))[0]


def test_a_file_larger_than_any_is_refused(tmp_path):
    (tmp_path / "own.urdf").write_text("<robot>" + " " * MOST_BYTES)
    assert "at most 1,048,576 are read" in problems(tmp_path / "own.urdf")[0]


def test_the_urdf_of_a_robot_lies_beside_its_file(tmp_path):
    text = (
        "robot:\n  name: own\n  height_m: 0.3\n  radius_m: 0.3\n  urdf: NAME\n"
        "  limits: {v_min: 0, v_max: 1, w_max: 1}\n  lidar: {beams: 10, sectors: 5, range_m: 5, height_m: 0.2}\n"
    )
    written(tmp_path)
    (tmp_path / "robot.yaml").write_text(text.replace("NAME", "own.urdf"))
    read = read_robot(tmp_path / "robot.yaml").urdf
    assert read is not None
    assert np.isfinite(read_looks(read)[0].triangles).all()
    for name in ("gone.urdf", "../robot/own.urdf", str(tmp_path / "own.urdf").replace("own", "gone"), '"a\\0b"'):
        (tmp_path / "robot.yaml").write_text(text.replace("NAME", name))
        with pytest.raises(ProtocolError, match=r"robot.yaml:5: robot.urdf = .*must be the name of a file in the same"):
            read_robot(tmp_path / "robot.yaml")


def with_visuals(shapes: list[str]) -> str:
    visuals = "".join(f"<visual><geometry>{shape}</geometry></visual>" for shape in shapes)
    return f'<robot name="own"><link name="b">{visuals}</link></robot>'


def test_a_mesh_is_read_once_however_many_parts_show_it(tmp_path, monkeypatch):
    stl(tmp_path)
    read = []
    loaded = urdf._loaded
    monkeypatch.setattr(urdf, "_loaded", lambda file, content: read.append(file) or loaded(file, content))
    mesh = '<mesh filename="body.stl" scale="0.001 0.001 0.001"/>'
    assert describe(read_looks(written(tmp_path, text=with_visuals([mesh] * 4))))["parts"] == 4
    assert len(read) == 1


def test_nothing_is_read_after_what_is_too_much(tmp_path):
    cylinder = '<cylinder radius="0.1" length="0.3"/>'
    (told,) = problems(written(tmp_path, text=with_visuals([cylinder] * 5_000)))
    assert "at most 100,000 are shown" in told


def test_all_meshes_have_one_room(tmp_path, monkeypatch):
    monkeypatch.setattr(urdf, "MOST_MESH_BYTES", 1_000)
    monkeypatch.setattr(urdf, "MOST_OBJ_LINES", 100)
    shapes = []
    for name in ("a", "b"):
        stl(tmp_path, f"{name}.stl")
        shapes.append(f'<mesh filename="{name}.stl" scale="0.001 0.001 0.001"/>')
    (told,) = problems(written(tmp_path, text=with_visuals(shapes)))
    assert "at most 1,000 are read of all meshes" in told
    (tmp_path / "c.obj").write_bytes(b"v 0 0 0\n" * 110)
    assert "has too many lines" in problems(written(tmp_path, '<mesh filename="c.obj"/>'))[0]
