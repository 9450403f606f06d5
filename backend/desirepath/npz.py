"""The one file format of everything that is arrays with a header: NPZ with the header as JSON, never pickled.

Trajectories, demonstrations, policies, query sets, reward models and finished work are written and read here, the same
content always as the same bytes. What a header or an array means is said where each of them lives.
"""

from __future__ import annotations

import io
import json
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]
HEADER = "meta"  # the array that holds the JSON, as uint8
SUFFIX = ".npy"
NUMBERS = "biuf"  # kinds of NumPy types that are read: bool, int, unsigned int, float
COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others may take much memory for their own dictionaries
MOST_DIMENSIONS = 8
MIB = 2**20


class NpzError(ValueError):
    """Not a file of ours, or larger than it may be; says what was found and what would work."""


@dataclass(frozen=True)
class Bounds:
    """How large what is read may become, whatever the file's own size: a few kilobytes can hold gigabytes of zeros."""

    arrays: int = 1_000
    header_bytes: int = 32 * MIB
    all_bytes: int = 512 * MIB


BOUNDS = Bounds()


def to_npz(header: Mapping[str, object], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """The file's bytes; the arrays stand in it in the order given."""
    out = io.BytesIO()
    described = np.frombuffer(json.dumps(header, sort_keys=True).encode(), dtype=np.uint8)
    np.savez_compressed(out, allow_pickle=False, **{HEADER: described}, **arrays)
    return out.getvalue()


def from_npz(content: bytes, bounds: Bounds = BOUNDS) -> tuple[dict[str, Any], Arrays]:
    """(header, arrays by name) of `to_npz`. Nothing larger than the bounds is ever unpacked. Raises NpzError."""
    with _opened(content, bounds) as archive:
        arrays = {name: _array(archive, name) for name in _names(archive) if name != HEADER}
        return _header(archive, bounds), arrays


def npz_header(content: bytes) -> dict[str, Any]:
    """The header alone. Raises NpzError."""
    with _opened(content, BOUNDS) as archive:
        return _header(archive, BOUNDS)


@contextmanager
def _opened(content: bytes, bounds: Bounds) -> Iterator[zipfile.ZipFile]:
    """The archive, once the sizes that it names are within the bounds; every way to be broken is an NpzError."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            if len(members) > bounds.arrays:
                raise NpzError(f"{len(members)} arrays; at most {bounds.arrays} are read")
            if len({member.filename for member in members}) != len(members):
                raise NpzError("two arrays of one name")
            if any(member.compress_type not in COMPRESSIONS for member in members):
                raise NpzError("compressed otherwise than NumPy does it")
            unpacked = sum(member.file_size for member in members)  # no more than it says is ever unpacked of a member
            if unpacked > bounds.all_bytes:
                raise NpzError(f"{unpacked} bytes when unpacked; at most {bounds.all_bytes} are read")
            yield archive
    except NpzError:
        raise
    except KeyError as problem:
        raise NpzError(f"{problem} is missing") from None
    except (ValueError, OSError, EOFError, RuntimeError, SyntaxError, tokenize.TokenError) as problem:
        raise NpzError(str(problem) or type(problem).__name__) from None
    except (zipfile.BadZipFile, zlib.error, struct.error, IndexError, TypeError, OverflowError) as problem:
        raise NpzError(str(problem) or type(problem).__name__) from None


def _names(archive: zipfile.ZipFile) -> list[str]:
    return [member.filename.removesuffix(SUFFIX) for member in archive.infolist()]


def _header(archive: zipfile.ZipFile, bounds: Bounds) -> dict[str, Any]:
    size = archive.getinfo(HEADER + SUFFIX).file_size
    if size > bounds.header_bytes:
        raise NpzError(f"a header of {size} bytes; at most {bounds.header_bytes} are read")
    header = json.loads(_array(archive, HEADER).tobytes())
    if not isinstance(header, dict):
        raise NpzError(f"the header is {type(header).__name__}, must be an object")
    return header


def _array(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """One array. What it says of its own type and shape is checked against its bytes before any memory is taken."""
    content = archive.read(name + SUFFIX)
    stream = io.BytesIO(content)
    version = np.lib.format.read_magic(stream)
    if version == (1, 0):
        shape, by_column, dtype = np.lib.format.read_array_header_1_0(stream)
    elif version == (2, 0):
        shape, by_column, dtype = np.lib.format.read_array_header_2_0(stream)
    else:
        raise NpzError(f"array {name!r} has version {version} of NumPy's format; read are 1.0 and 2.0")
    if dtype.kind not in NUMBERS:
        raise NpzError(f"array {name!r} holds {dtype}; read are numbers only, never pickled objects")
    count = 1
    for length in shape:
        count *= length
    if len(shape) > MOST_DIMENSIONS or count * dtype.itemsize != len(content) - stream.tell():
        raise NpzError(f"array {name!r} says shape {shape} of {dtype}, which its {len(content)} bytes do not hold")
    values = np.frombuffer(content, dtype, offset=stream.tell())
    return values.reshape(shape, order="F" if by_column else "C").copy(order="K")
