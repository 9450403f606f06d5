"""What a lab brings as a setup is bounded before it is read, said by file and line where it is wrong, and kept whole or
not at all."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import pytest

from desirepath import zip_files
from desirepath.grammar.source import ProtocolError
from desirepath.installed import DATASETS
from desirepath.simulation import setup_intake
from desirepath.simulation.setup_intake import CHECKED, IntakeError, checked, gather, remove, take_in, take_out, unpack
from desirepath.simulation.setups import (
    SetupError,
    broken_setups,
    get_setup,
    own_setups,
    setup_folders,
    tell_changed,
    trainable_setups,
    uploaded_setups,
)
from tests.simulation.test_ground_maps import draw_map


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of setups of an installation of its own."""
    monkeypatch.setenv("DESIREPATH_DATA", str(tmp_path / "data"))
    monkeypatch.delenv("DESIREPATH_SETUPS", raising=False)
    uploaded_setups().mkdir(parents=True)
    return uploaded_setups()


@pytest.fixture
def files(tmp_path: Path) -> dict[str, bytes]:
    """A map and nothing else."""
    (tmp_path / "brought").mkdir()
    draw_map(tmp_path / "brought")
    return {file.name: file.read_bytes() for file in (tmp_path / "brought").iterdir()}


def zipped(files: dict[str, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in files.items():
            packed.writestr(name, content)
    return out.getvalue()


def test_a_map_and_a_shipped_robot_are_a_setup_that_is_found_at_once(root, files):
    told = take_in("our_lab", files, root, "turtlebot3_burger")
    assert "our_lab" in own_setups()
    setup = get_setup("our_lab")
    assert (told["map"]["size_m"], told["scenes"]["drawn"]) == ([8.1, 6.1], 20)
    # Sized to the robot: 0.22 m/s needs longer for less, and looks ahead as far.
    assert setup.plan.way_m[1] < 4
    assert setup.max_steps * 0.2 * 0.22 > 2 * setup.plan.way_m[1]
    assert setup.gamma > get_setup("study_room").gamma
    again = unpack("our_lab.zip", io.BytesIO(take_out("our_lab")))
    assert set(again) == {"setup.yaml", "map.yaml", "map.pgm", CHECKED}
    remove("our_lab", root)
    assert "our_lab" not in own_setups()
    assert list(root.iterdir()) == []


def test_a_zip_with_one_folder_in_it_is_taken_as_that_folder(files):
    packed = zipped({f"lab/{name}": content for name, content in files.items()} | {"__MACOSX/lab/._map": b"x"})
    assert unpack("lab.zip", io.BytesIO(packed)) == files


@pytest.mark.parametrize(
    ("name", "changed", "says"),
    [
        ("Our Lab", {}, "a setup's name is of lower-case letters"),
        ("study_room", {}, "there is a setup of this name"),
        ("ours", {"../up.yaml": b"x"}, "is no name that is taken"),
        ("ours", {"/etc/x.yaml": b"x"}, "is no name that is taken"),
        ("ours", {"a/b/c/d/e.stl": b"x"}, "at most 3 folders"),
        ("ours", {"setup.yaml": b"robot: turtlebot2\n", "a" * 90 + ".stl": b"x"}, "is no name that is taken"),
        ("ours", {"map.yaml": b"", "maps/map.yaml": b"image: map.pgm"}, "maps/map.yaml: lies in a folder"),
        ("ours", {"MAP.yaml": b"x"}, "differ in capitals alone"),
        ("ours", {"map.pgm/x.stl": b"x"}, "map.pgm: is the name of a file and of a folder"),
        ("ours", {"setup.yaml/x.stl": b"x"}, "setup.yaml: is the name of a file and of a folder"),
        ("ours", {"other.yaml": b"image: map.pgm"}, "not one map.yaml"),
    ],
)
def test_what_cannot_be_taken_is_said_and_nothing_stays(root, files, name, changed, says):
    with pytest.raises(IntakeError, match=says):
        take_in(name, files | changed, root, "turtlebot2")
    assert list(root.iterdir()) == []


def test_without_a_robot_the_shipped_ones_are_named(root, files):
    with pytest.raises(IntakeError, match=r"no setup.yaml and no robot.yaml: choose one of .*turtlebot2"):
        take_in("ours", files, root)


def test_problems_in_files_are_those_of_setup_check(root, files):
    wrong = files["map.yaml"].replace(b"origin: [-4.0, -3.0, 0.0]\n", b"")
    with pytest.raises(ProtocolError) as found:
        take_in("ours", files | {"map.yaml": wrong}, root, "turtlebot2")
    (problem,) = found.value.problems
    assert (problem.file, problem.field) == ("map.yaml", "origin")
    with pytest.raises(ProtocolError, match=r"setup.yaml:1: robots = .* did you mean robot"):
        take_in("ours", files | {"setup.yaml": b"robots: turtlebot2\nworld: {name: study_room}\n"}, root)
    assert list(root.iterdir()) == []


def test_zips_are_bounded_before_they_are_unpacked(files, monkeypatch):
    with pytest.raises(IntakeError, match="is no zip that can be read"):
        unpack("x.zip", io.BytesIO(b"PK\x03\x04 and so on"))
    with pytest.raises(IntakeError, match="is no zip that can be read"):
        unpack("x.zip", io.BytesIO(zipped(files)[:-40]))
    with pytest.raises(IntakeError, match="holds 201 files; at most 200"):
        unpack("x.zip", io.BytesIO(zipped({f"{k}.stl": b"" for k in range(201)})))
    monkeypatch.setattr(setup_intake, "LARGEST_FILE", 10_000)
    with pytest.raises(IntakeError, match=r"x.zip: a.stl makes it too large"):
        unpack("x.zip", io.BytesIO(zipped({"a.stl": bytes(1_000_000)})))
    monkeypatch.setattr(zip_files, "MOST_DIRECTORY_BYTES", 1_000)
    with pytest.raises(IntakeError, match=r"x.zip: is no zip that can be read: its list of files is longer"):
        unpack("x.zip", io.BytesIO(zipped({f"{k}.stl": b"" for k in range(100)})))


def test_files_of_other_kinds_are_left_out_and_told(root, files):
    told = take_in("ours", files | {"README.md": b"x", "base.npz": b"x"}, root, "turtlebot2")
    assert told["left_out"] == ["README.md", "base.npz"]
    assert checked(root / "ours") == told
    assert {file.name for file in (root / "ours").iterdir()} == {*files, "setup.yaml", CHECKED}
    again = unpack("ours.zip", io.BytesIO(take_out("ours")))
    remove("ours", root)
    assert "left_out" not in take_in("ours", again, root)
    with pytest.raises(IntakeError, match=r"no files: .* files taken are .yaml"):
        take_in("other", {"run.py": b"x"}, root)


def test_one_broken_setup_takes_no_list_down(root, files):
    for name in ("broken", "fine", "shadow"):
        take_in(name, files, root, "turtlebot2")
    (root / "broken/setup.yaml").write_text("robots: turtlebot2\n")
    (root / "shadow").rename(root / "study_room")
    tell_changed()
    assert own_setups() == ("fine",)
    assert "study_room" in trainable_setups()
    assert setup_folders()["study_room"].parent == DATASETS.resolve()
    told = broken_setups()
    assert set(told) == {"broken", "study_room"}
    assert "did you mean robot" in told["broken"]


def test_all_zips_of_an_upload_have_one_room(files, monkeypatch):
    monkeypatch.setattr(setup_intake, "LARGEST_ALL", 1_000_000)
    packed = zipped({"a.stl": bytes(600_000)})
    unread = io.BytesIO(packed)
    brought = [
        ("a.zip", io.BytesIO(packed)),
        ("b.zip", io.BytesIO(zipped({"b.stl": bytes(600_000)}))),
        ("c.zip", unread),
    ]
    with pytest.raises(IntakeError, match=r"b.zip: b.stl makes it too large"):
        gather(brought)
    assert unread.tell() == 0
    with pytest.raises(IntakeError, match=r"a.stl: is brought twice"):
        gather([("a.zip", io.BytesIO(zipped({"a.stl": b"x"}))), ("a.stl", io.BytesIO(b"y"))])
    with pytest.raises(IntakeError, match=r"c.zip: holds 150 files; at most 200"):
        gather([(f"{n}.zip", io.BytesIO(zipped({f"{n}{k}.stl": b"" for k in range(150)}))) for n in "bc"])


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_zips_that_unpack_without_a_bound_are_refused(method):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as packed:
        packed.writestr("a.stl", bytes(1_000))
    with pytest.raises(IntakeError, match="is not packed by deflate"):
        unpack("x.zip", out)


def test_a_shipped_setup_is_not_removed(root):
    with pytest.raises(SetupError, match="was not brought to this installation"):
        remove("study_room", root)
