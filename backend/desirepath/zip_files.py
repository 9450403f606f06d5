"""Zips from elsewhere: opened with a bounded list of their files; what systems leave in them."""

from __future__ import annotations

import io
import zipfile
import zlib
from typing import BinaryIO

MOST_DIRECTORY_BYTES = 24 * 2**20  # of a zip's list of its files, about 200 for each of a data set's
BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError)
"""What `zipfile` raises for one that is cut, damaged, encrypted, or packed as it cannot unpack; beside OSError."""


class LongListError(zipfile.BadZipFile):
    """The list of its files is longer than MOST_DIRECTORY_BYTES."""


def open_zip(file: BinaryIO) -> zipfile.ZipFile:
    """That zip, to be read. Raises LongListError, or as BROKEN says."""
    return zipfile.ZipFile(_Bounded(file))


class _Bounded(io.RawIOBase):
    """A file that hands out so much at once: `zipfile` reads a zip's list of files whole, however long."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def read(self, size: int = -1) -> bytes:
        if not 0 <= size <= MOST_DIRECTORY_BYTES:
            size = MOST_DIRECTORY_BYTES + 1
        content = self._file.read(size)
        if len(content) > MOST_DIRECTORY_BYTES:
            raise LongListError(f"its list of files is longer than {MOST_DIRECTORY_BYTES // 2**20} MB")
        return content

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def seekable(self) -> bool:
        return True


def files_in(opened: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    """Its files, without what systems leave. Raises NotImplementedError for one that is packed otherwise than by
    deflate: of others `zipfile` unpacks as much as there is, however little is asked for."""
    files = [info for info in opened.infolist() if not info.is_dir()]
    for info in files:
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise NotImplementedError(f"{info.filename[:100]} is not packed by deflate, as zips mostly are; pack it so")
    return [info for info in files if not any(map(is_of_the_system, info.filename.split("/")))]


def is_of_the_system(name: str) -> bool:
    """Whether a file or folder is one that macOS or Windows leave wherever somebody looks."""
    return name in (".DS_Store", "__MACOSX", "Thumbs.db", "desktop.ini") or name.startswith("._")
