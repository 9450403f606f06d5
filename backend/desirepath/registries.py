"""Registries: the plug-ins of a kind, by name. A plug-in is a module with an attribute that its registry names.

The product's own are found by looking into a package, under the module's name; another distribution's by entry points,
`NAME = package.module` in the registry's group. Names are known before anything is imported: forms list them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import cached_property
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, Literal, TypeVar

T = TypeVar("T")


class RegistryError(LookupError):
    """A plug-in that is unknown, offered twice, or not what its registry needs."""


def find_offer(group: str, lacking: str) -> Any:
    """What another distribution offers in that group of entry points; raises LookupError(lacking) where none does."""
    for offered in entry_points(group=group):
        return offered.load()
    raise LookupError(lacking)


class Registry(Mapping[str, T]):
    """group: of entry points; packages: whose modules are looked at; attribute: what each plug-in's module ends with.
    A package may lie above whoever holds the registry: it is known by name until a plug-in of it is asked for."""

    def __init__(self, group: str, packages: str | tuple[str, ...], attribute: str) -> None:
        self.group, self._attribute = group, attribute
        self._packages = (packages,) if isinstance(packages, str) else packages
        self._loaded: dict[str, T] = {}

    @cached_property
    def modules(self) -> dict[str, str]:
        """Name -> module, in the names' order. Raises RegistryError where two are offered under one name."""
        found = dict[str, str]()
        for package in self._packages:
            spec = find_spec(package)
            for folder in (spec and spec.submodule_search_locations) or ():
                for name in (module.name for module in iter_modules([folder]) if not module.ispkg):
                    text = Path(folder, f"{name}.py").read_text("utf-8")
                    if self._attribute in re.findall(r"^\w+", text, re.MULTILINE):
                        found[name.rstrip("_")] = f"{package}.{name}"  # break_.py: Python has that word
        for entry in entry_points(group=self.group):
            if not re.fullmatch("[a-z][a-z0-9_]*", entry.name):  # it becomes part of addresses and of file names
                raise RegistryError(f"{self.group}: {entry.name!r} ({entry.value}) must be of a-z, 0-9 and _")
            if found.setdefault(entry.name, entry.value) != entry.value:
                taken = f"{entry.value} offers {entry.name!r}, as {found[entry.name]} does: rename one"
                raise RegistryError(f"{self.group}: {taken}")
        return dict(sorted(found.items()))

    def beside(self, ending: str) -> dict[str, Path]:
        """Name -> file beside another distribution's module, of the module's name with that ending (`note.html`). Only
        files that lie in that very folder."""
        found = {}
        for name, module in self.modules.items():
            try:
                spec = None if module.rpartition(".")[0] in self._packages else find_spec(module)
            except ModuleNotFoundError as missing:
                raise RegistryError(f"{self.group}: {name!r} is the module {module}: {missing}") from missing
            if spec is not None and spec.origin is not None:
                origin = Path(spec.origin).resolve()
                file = origin.with_name(origin.stem + ending)
                if file.is_file() and file.resolve() == file:
                    found[name] = file
        return found

    @property
    def literal(self) -> Any:
        """The type of a field that takes one of the names."""
        return Literal[tuple(self.modules)]

    def __iter__(self) -> Iterator[str]:
        return iter(self.modules)

    def __len__(self) -> int:
        return len(self.modules)

    def __contains__(self, name: object) -> bool:
        return name in self.modules

    def __getitem__(self, name: str) -> T:
        """Raises RegistryError saying what is known, or what a plug-in lacks."""
        if name not in self.modules:
            raise RegistryError(f"{self.group}: no {name!r}; known are {', '.join(self)}")
        if name not in self._loaded:
            try:
                self._loaded[name] = getattr(import_module(self.modules[name]), self._attribute)
            except Exception as wrong:  # whatever another distribution's module does, its name is said
                needed = f"{name!r} is the module {self.modules[name]}, which needs {self._attribute}"
                raise RegistryError(f"{self.group}: {needed}: {wrong}") from wrong
        return self._loaded[name]
