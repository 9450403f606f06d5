"""A data set that comes as a zip is unpacked, and refused before anything is unpacked where it is made to harm."""

from __future__ import annotations

import io
import random
import shutil
import stat
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.dataset import unpacking
from desirepath.store.dataset.columns import CHECKSUMS_FILE
from desirepath.store.dataset.importing import import_dataset
from desirepath.store.dataset.reading import DatasetError, check_files
from desirepath.store.dataset.unpacking import unpack
from desirepath.store.dataset.writing import export_study
from tests.store.small_study import SmallStudy


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set as the Data page packs it: its folder, and `export.zip` beside it. Only read it."""
    folder = tmp_path_factory.mktemp("packed")
    database = Database(f"sqlite:///{folder / 'desirepath.sqlite'}")
    database.migrate()
    study = SmallStudy(database, ArtefactStore((folder / "artefacts").as_uri()))
    study.participant("P1")
    export_study(database, study.files, study.id, folder / "quick-1")
    shutil.make_archive(str(folder / "export"), "zip", folder, "quick-1")
    return folder


@pytest.mark.parametrize("top", ["quick-1", "."])
def test_a_zip_is_imported_whatever_the_systems_it_came_by_left_in_it(exported: Path, tmp_path: Path, top: str) -> None:
    copy = shutil.copytree(exported / "quick-1", tmp_path / "quick-1")
    for name in (".DS_Store", "Thumbs.db", "protocol/desktop.ini", "trajectories/.DS_Store", "._study.json"):
        (copy / name).write_bytes(b"\0")
    (copy / "__MACOSX" / "deep" / "er").mkdir(parents=True)
    (copy / "__MACOSX" / "deep" / "er" / "._study.json").write_bytes(b"\0")
    check_files(copy)
    root = tmp_path if top == "quick-1" else copy
    packed = Path(shutil.make_archive(str(tmp_path / "data"), "zip", root, top))
    fresh = Database(f"sqlite:///{tmp_path / 'there.sqlite'}")
    fresh.migrate()
    with unpack(packed) as folder:
        assert not list(folder.rglob(".DS_Store"))
        said = import_dataset(fresh, ArtefactStore((tmp_path / "there").as_uri()), folder)
    assert said["participants"] == 1
    assert not folder.exists()


def plain(name: str, mode: int = 0o644 | stat.S_IFREG) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name)
    info.external_attr = mode << 16
    return info


def another(exported: Path, tmp_path: Path, change: Callable[[zipfile.ZipFile], object]) -> Path:
    """The data set's zip, changed."""
    packed = tmp_path / "data.zip"
    shutil.copy(exported / "export.zip", packed)
    with zipfile.ZipFile(packed, "a", zipfile.ZIP_DEFLATED) as out:
        change(out)
    return packed


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda z: z.writestr("../evil.txt", "x"), "is called or lies"),
        (lambda z: z.writestr("quick-1/../../evil.txt", "x"), "is called or lies"),
        (lambda z: z.writestr("/tmp/evil.txt", "x"), "is called or lies"),
        (lambda z: z.writestr("quick-1/..\\..\\evil.txt", "x"), "is called or lies"),
        (lambda z: z.writestr("C:/evil.txt", "x"), "is called or lies"),
        (lambda z: z.writestr("quick-1/a/b/c/d/e/f/g/h.txt", "x"), "is called or lies"),
        (lambda z: z.writestr("quick-1/", ""), None),
        (lambda z: z.writestr("quick-1//x", ""), "is called or lies"),
        (lambda z: z.writestr("quick-1/a\nb", ""), "is called or lies"),
        (lambda z: z.writestr("quick-1/" + "x" * 200, ""), "is called or lies"),
        (lambda z: z.writestr(plain("quick-1/link", 0o777 | stat.S_IFLNK), "/etc/passwd"), "is a link or a device"),
        (lambda z: z.writestr(plain("quick-1/tty", 0o666 | stat.S_IFCHR), ""), "is a link or a device"),
        (lambda z: z.writestr("quick-1/STUDY.json", "{}"), "is there twice"),
        (lambda z: z.writestr("quick-1/trials.csv", "{}"), "is there twice"),
        (lambda z: z.writestr("quick-1/trials.csv/x", "{}"), "cannot be unpacked"),
        (lambda z: z.writestr("elsewhere.txt", "x"), "lies outside the data set's folder quick-1"),
        (lambda z: z.writestr(f"quick-2/{CHECKSUMS_FILE}", "x"), "holds no exported data set, or several"),
        (lambda z: z.writestr("quick-1/bomb", b"\0" * 2**26), "times its size"),
        (lambda z: z.writestr("quick-1/lzma", b"x", zipfile.ZIP_LZMA), "another method than deflate"),
        (lambda z: [z.writestr(f"quick-1/{n}", b"") for n in range(101)], "holds 1"),
    ],
)
@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_zip_that_is_made_to_harm_is_refused_and_leaves_nothing(
    exported: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    change: Callable[[zipfile.ZipFile], object],
    says: str,
) -> None:
    monkeypatch.setattr(unpacking, "MOST_FILES", 100)
    monkeypatch.setattr(unpacking, "FEW_BYTES", 2**20)
    monkeypatch.setattr(unpacking.tempfile, "tempdir", str(tmp_path / "unpacked"))
    (tmp_path / "unpacked").mkdir()
    packed = another(exported, tmp_path, change)
    began = sorted(tmp_path.rglob("*"))
    if says is None:
        with unpack(packed) as folder:
            check_files(folder)
    else:
        with pytest.raises(DatasetError, match=says), unpack(packed):
            pass
    assert sorted(tmp_path.rglob("*")) == began


def test_what_a_zip_says_of_itself_is_not_believed(exported: Path, tmp_path: Path) -> None:
    """A declared size of one byte, a list of files of 4 GB: no more is read than the limits."""
    packed = another(exported, tmp_path, lambda z: z.writestr("quick-1/bomb", b"\0" * 2**24))
    content = bytearray(packed.read_bytes())
    real, told = (2**24).to_bytes(4, "little"), (1).to_bytes(4, "little")
    packed.write_bytes(content.replace(real, told))
    with pytest.raises(DatasetError, match="cannot be unpacked"), unpack(packed):
        pass
    end = content.rindex(b"PK\x05\x06")
    content[end + 12 : end + 16] = (2**31).to_bytes(4, "little")  # of the list of files
    packed.write_bytes(content)
    with pytest.raises(DatasetError), unpack(packed):
        pass
    monster = io.BytesIO()
    with zipfile.ZipFile(monster, "w") as out:
        for n in range(unpacking.MOST_DIRECTORY_BYTES // 60_000 + 1):
            out.writestr(f"{n:06}" + "x" * 60_000, b"")
    packed.write_bytes(monster.getvalue())
    with pytest.raises(DatasetError, match="list of files is longer"), unpack(packed):
        pass


def test_no_broken_zip_does_more_than_be_refused(exported: Path, tmp_path: Path) -> None:
    whole = (exported / "export.zip").read_bytes()
    draw = random.Random(1)
    packed = tmp_path / "data.zip"
    for content in (b"", b"PK", b"PK\x05\x06" + b"\0" * 18, b"text", whole[:-30], whole[: len(whole) // 2]):
        packed.write_bytes(content)
        with pytest.raises(DatasetError), unpack(packed):
            pass
    directory = whole.rindex(b"PK\x05\x06") - 40 * 150
    for _ in range(150):
        content = bytearray(whole)
        for _ in range(draw.randint(1, 8)):
            content[draw.randrange(directory, len(content))] = draw.randrange(256)
        packed.write_bytes(content)
        try:
            with unpack(packed) as folder:
                check_files(folder)
        except DatasetError:
            pass


def test_a_folder_or_a_name_that_is_none_is_given_on(tmp_path: Path) -> None:
    for given in (tmp_path, tmp_path / "nothing"):
        with unpack(given) as folder:
            assert folder == given
