"""What is kept as one file: to bytes and back, to a path and back, and its digest. The format beneath is `npz.py`'s."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

from numpy.typing import NDArray

from desirepath.npz import BOUNDS, Arrays, Bounds, from_npz, to_npz


class Stored(ABC):
    """noun: what it is called in messages. raises: the error for a file that is another, or none."""

    noun: ClassVar[str]
    raises: ClassVar[type[ValueError]] = ValueError

    @abstractmethod
    def to_bytes(self) -> bytes:
        """The same content always gives the same bytes."""

    @classmethod
    @abstractmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Read `to_bytes` back, never unpickling. Raises `raises` for anything else."""

    def save(self, path: Path) -> None:
        """Write the file, and the folders that it lies in."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(self.to_bytes())

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a file. Raises `raises`, naming it, if it is missing or something else."""
        try:
            return cls.from_bytes(path.read_bytes())
        except OSError as problem:
            raise cls.raises(f"cannot read {cls.noun} {path}: {problem.strerror}") from None
        except cls.raises as problem:
            raise cls.raises(f"{path.name}: {problem}") from None

    def digest(self) -> str:
        """sha256 of `to_bytes`, its identity in the store and in lineages."""
        return hashlib.sha256(self.to_bytes()).hexdigest()


class StoredArrays(Stored):
    """An NPZ file of arrays and a header, which names the format. read_too: other formats that `from_parts` knows."""

    file_format: ClassVar[str]
    read_too: ClassVar[tuple[str, ...]] = ()
    bounds: ClassVar[Bounds] = BOUNDS

    @abstractmethod
    def to_parts(self) -> tuple[Mapping[str, object], Mapping[str, NDArray[Any]]]:
        """(header, arrays by name)."""

    @classmethod
    @abstractmethod
    def from_parts(cls, header: dict[str, Any], arrays: Arrays) -> Self:
        """Back from `to_parts`; whatever ordinary error it raises names what is wrong with the file."""

    def to_bytes(self) -> bytes:
        header, arrays = self.to_parts()
        return to_npz({"format": self.file_format, **header}, arrays)

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        try:
            header, arrays = from_npz(data, cls.bounds)
            if header.get("format") not in (cls.file_format, *cls.read_too):
                raise ValueError(f"format {header.get('format')!r}; what is read here is {cls.file_format!r}")
            return cls.from_parts(header, arrays)
        except KeyError as problem:
            raise cls.raises(f"not a desirepath {cls.noun} (.npz): {problem} is missing") from None
        except (ArithmeticError, AttributeError, IndexError, RuntimeError, TypeError, ValueError) as problem:
            raise cls.raises(f"not a desirepath {cls.noun} (.npz): {problem}") from None
