"""One served installation for everything that leaves it whole; who breaks a server brings one of their own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from tests.faults.installation import Installation, Visitor
from tests.packed_once import packed_once

__all__ = ["packed_once", "served"]


@dataclass(frozen=True)
class Served:
    """A running product: where it is, and what it stored."""

    url: str
    installation: Installation

    def visitor(self, *, bot: bool = False) -> Visitor:
        return Visitor(self.url, self.installation.study, bot=bot)


@pytest.fixture(scope="package")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    installation = Installation(tmp_path_factory.mktemp("served"))
    with installation.serving() as (url, _):
        yield Served(url, installation)
