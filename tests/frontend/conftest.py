"""A server of the example pages."""

from collections.abc import Iterator

import pytest

from tests.frontend.example_pages import example_application
from tests.running import served


@pytest.fixture(scope="session")
def pages() -> Iterator[str]:
    """Address of a server of the example pages."""
    with served(example_application()) as address:
        yield address
