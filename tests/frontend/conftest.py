"""A server of the example pages."""

from collections.abc import Iterator

import pytest

from tests.frontend.example_pages import example_application
from tests.packed_once import packed_once
from tests.running import served

__all__ = ["packed_once", "pages"]


@pytest.fixture(scope="session")
def pages() -> Iterator[str]:
    """Address of a server of the example pages."""
    with served(example_application()) as address:
        yield address
