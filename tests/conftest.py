"""What tests of several rooms share: a real Chromium, and an empty store in a folder of its own."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

# Set before numba is imported: two cores are shared by everything.
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

CHROMIUM_FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


@pytest.fixture(scope="module")  # not longer: playwright keeps an event loop running, which other tests cannot have
def chromium() -> Iterator["Browser"]:  # noqa: F821
    """Debian's Chromium with software WebGL, driven by playwright's sync API."""
    from playwright.sync_api import sync_playwright

    executable = shutil.which("chromium")
    if executable is None:
        pytest.fail("Chromium is missing; `make test` installs it (scripts/setup_chromium.sh)")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=CHROMIUM_FLAGS, headless=True)
        yield browser
        browser.close()


@pytest.fixture
def database(tmp_path: Path) -> "Database":  # noqa: F821
    """An empty, migrated SQLite database."""
    from backend.store.database import Database

    empty = Database(f"sqlite:///{tmp_path / 'desirepath.sqlite'}")
    empty.migrate()
    return empty


@pytest.fixture
def files(tmp_path: Path) -> "ArtefactStore":  # noqa: F821
    """An empty artefact store."""
    from backend.store.artefacts import ArtefactStore

    return ArtefactStore((tmp_path / "artefacts").as_uri())
