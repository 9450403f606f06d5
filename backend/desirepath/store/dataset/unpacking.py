"""A data set that comes as a zip file, as the lab's Data page hands it out. Reading what lies in it is `reading.py`'s.

A zip from elsewhere may be made to harm: all that it says of itself is bounded before anything is unpacked, and no more
is unpacked than it says.
"""

from __future__ import annotations

import contextlib
import re
import shutil
import stat
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from desirepath.os_errors import in_words
from desirepath.store.dataset.columns import CHECKSUMS_FILE
from desirepath.store.dataset.reading import DatasetError
from desirepath.zip_files import BROKEN, MOST_DIRECTORY_BYTES, LongListError, is_of_the_system, open_zip

# Ours. 31 people in three views leave 844 files, 65 MB.
MOST_FILES = 100_000
MOST_BYTES = 4 * 2**30  # unpacked
FEW_BYTES = 2**28  # never too much, however small the zip is
MOST_DENSE = 100  # bytes out of one byte of the zip; data sets have 2 to 20
DEEPEST = 8  # names in a path; the deepest of ours has six, in the Data page's zip
_PART = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,119}")
_KINDS = (0, stat.S_IFREG, stat.S_IFDIR)  # 0: packed where there are no such kinds
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


@contextlib.contextmanager
def unpack(data_set: Path) -> Iterator[Path]:
    """The folder of a data set: the one that is given, or what a zip file holds, until the block ends.

    Raises DatasetError for a file that is no zip, that holds no data set or more than that, or that is made to harm.
    """
    if not data_set.is_file():
        yield data_set
        return
    with tempfile.TemporaryDirectory(prefix="desirepath-") as place:
        try:
            with data_set.open("rb") as raw, open_zip(raw) as packed:
                top, files = _contents(packed, data_set)
                free = shutil.disk_usage(place).free
                if (size := sum(info.file_size for info in files.values())) > free:
                    raise DatasetError(
                        f"{data_set.name}: needs {_mb(size)} in {place}, {_mb(free)} are free; make room"
                    )
                for name, info in files.items():
                    target = Path(place) / name
                    target.parent.mkdir(parents=True, exist_ok=True)
                    with packed.open(info) as source, target.open("xb") as out:
                        shutil.copyfileobj(source, out)
        except DatasetError:
            raise
        except LongListError:
            most = _mb(MOST_DIRECTORY_BYTES)
            raise DatasetError(f"its list of files is longer than {most}, which no data set's is") from None
        except (*BROKEN, ValueError, OSError) as problem:
            reason = in_words(problem)
            message = f"{data_set.name}: cannot be unpacked ({reason}); give the folder or the zip of a data set"
            raise DatasetError(message) from None
        yield Path(place) / top


def _contents(packed: zipfile.ZipFile, source: Path) -> tuple[PurePosixPath, dict[str, zipfile.ZipInfo]]:
    """The data set's own folder in the zip, and its files by name; what systems leave there is passed over."""

    def refused(name: str, reason: str) -> DatasetError:
        return DatasetError(f"{source.name}: {name[:200]!r} {reason}; nothing was unpacked")

    files: dict[str, zipfile.ZipInfo] = {}
    seen: set[str] = set()
    infos = packed.infolist()
    if len(infos) > MOST_FILES:
        raise DatasetError(f"{source.name}: holds {len(infos):,} files, at most {MOST_FILES:,} are unpacked")
    for info in infos:
        name = info.orig_filename.removesuffix("/")
        parts = name.split("/")
        if any(map(is_of_the_system, parts)):
            continue
        if len(parts) > DEEPEST or not all(map(_PART.fullmatch, parts)):
            raise refused(info.orig_filename, "is called or lies as no file of a data set is")
        if stat.S_IFMT(info.external_attr >> 16) not in _KINDS:
            raise refused(name, "is a link or a device, which no data set holds")
        if info.flag_bits & 1 or info.compress_type not in _METHODS:
            raise refused(name, "is encrypted or packed by another method than deflate; pack the folder again")
        if info.is_dir():
            continue
        if name.casefold() in seen:
            raise refused(name, "is there twice")
        seen.add(name.casefold())
        files[name] = info
    size, packed_size = sum(info.file_size for info in files.values()), source.stat().st_size
    if size > min(MOST_BYTES, max(FEW_BYTES, MOST_DENSE * packed_size)):
        raise DatasetError(
            f"{source.name}: would be {_mb(size)} unpacked, {size // max(packed_size, 1)} times its size; at most "
            f"{_mb(MOST_BYTES)} and {MOST_DENSE} times are unpacked"
        )
    tops = [PurePosixPath(name).parent for name in files if PurePosixPath(name).name == CHECKSUMS_FILE]
    if len(tops) != 1 or len(tops[0].parts) > 1:
        raise DatasetError(f"{source.name}: holds no exported data set, or several; each has its {CHECKSUMS_FILE}")
    for name in files:
        if not PurePosixPath(name).is_relative_to(tops[0]):
            raise refused(name, f"lies outside the data set's folder {tops[0]}")
    return tops[0], files


def _mb(size: int) -> str:
    return f"{size / 2**20:,.0f} MB"
