"""What tests of several rooms share: a real Chromium, an empty store in a folder of its own, a small disk."""

import gc
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import structlog

# A logged error drawn with all that surrounds it takes seconds of a core; the product writes it plain, too.
structlog.configure(
    processors=[
        structlog.contextvars.merge_contextvars,
        structlog.processors.add_log_level,
        structlog.dev.ConsoleRenderer(colors=False, exception_formatter=structlog.dev.plain_traceback),
    ]
)

# What is imported for thousands of tests stays: looking through it for garbage takes a fifth of collecting them.
gc.disable()

# Before NumPy and Numba are imported, which many tests do before the product: it asks for one thread of linear algebra.
# Two cores are shared by everything, and two threads for small matrices take up to ten times the processor of one.
import_module("desirepath")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

CHROMIUM_FLAGS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


PAGE_TIMEOUT_MS = 30_000
"""What a page gets to show what is expected of it, on a busy machine too."""

HERE = Path(__file__).parent
BROWSER_FIXTURES = frozenset({"chromium"})
SERVER_FIXTURES = frozenset({"postgres_server", "either", "installation", "rig", "small_disk"})
# Places whose tests ask the whole application over HTTP, or start servers, workers and training processes.
SERVER_PLACES = (
    *("web", "frontend", "faults", "jobs", "journeys", "cli", "test_wheel.py"),
    *("store/test_files_on_s3.py", "stage/test_viser_hooks.py", "deploy/test_node.py"),
)
# Places whose tests train, compute chapters and benchmarks, draw many cohorts, compile, run the documentation's code or
# libraries of others that take seconds to load.
SLOW_PLACES = (
    "experiments",
    "learning",
    "demonstrations/test_td3_bc.py",
    "simulation/test_parity.py",
    "report/test_simulated_cohorts.py",
    "store/test_dataset_standards.py",
    "test_notebook.py",
    "test_own_setup.py",
    "test_setup_training.py",
    "test_recipes.py",
    "test_compiled_functions.py",
)


SPEEDS = ("browser", "slow", "server", "fast")
STARTED = {"chromium", "chromium-headless-shell", "initdb", "caddy", "moto.server", "serve", "worker"}
"""Words of commands that start a browser, a server or a worker."""
_running: list[pytest.Item] = []


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Where only fast tests are asked for, places that have none are not even imported."""
    if config.option.markexpr == "fast" and collection_path.is_relative_to(HERE):
        return _lies_in(collection_path.relative_to(HERE).as_posix(), (*SERVER_PLACES, *SLOW_PLACES)) or None
    return None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give every test the first that fits of browser, server, slow and fast, by what it uses and where it lies.

    Files with long tests come first, so that processes which share the files end at about the same time; those with
    browsers in turn with others, so that browsers, which draw in software, seldom draw beside each other.
    """
    ranks: dict[Path, int] = {}
    for item in items:
        place = item.path.relative_to(HERE).as_posix() if item.path.is_relative_to(HERE) else ""
        speed = _speed_of(place, frozenset(getattr(item, "fixturenames", ())))
        item.add_marker(speed)
        ranks[item.path] = min(ranks.get(item.path, len(SPEEDS)), SPEEDS.index(speed))
    with_browser = [path for path, rank in ranks.items() if SPEEDS[rank] == "browser"]
    others = sorted(ranks.keys() - set(with_browser), key=lambda path: (ranks[path], path))
    places = {path: 2 * turn for turn, path in enumerate(with_browser)}
    places |= {path: 2 * turn + 1 for turn, path in enumerate(others)}
    items.sort(key=lambda item: places[item.path])


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


def _speed_of(place: str, fixtures: frozenset[str]) -> str:
    if fixtures & BROWSER_FIXTURES:
        return "browser"
    if fixtures & SERVER_FIXTURES or _lies_in(place, SERVER_PLACES):
        return "server"
    return "slow" if _lies_in(place, SLOW_PLACES) else "fast"


def _lies_in(place: str, places: tuple[str, ...]) -> bool:
    return any(place == one or place.startswith(f"{one}/") for one in places)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    _running[:] = [item]
    try:
        return (yield)
    finally:
        _running.clear()


def _hold_fast_to_it(event: str, arguments: tuple[Any, ...]) -> None:
    """A test that is marked fast, or a fixture made for it, starts no server, worker or browser."""
    if event == "socket.bind":
        starts = arguments[0].family != socket.AF_UNIX
    elif event == "subprocess.Popen":
        starts = bool(STARTED & {Path(os.fsdecode(word)).name for word in arguments[1]})
    else:
        return
    on_postgres = "DESIREPATH_TEST_DATABASE_URL" in os.environ  # then every test with a database is on a server
    if starts and not on_postgres and any(item.get_closest_marker("fast") for item in _running):
        raise AssertionError(f"{_running[0].nodeid} is marked fast: {event} {arguments[1]}; see tests/conftest.py")


sys.addaudithook(_hold_fast_to_it)


@pytest.fixture(scope="module")  # not longer: playwright keeps an event loop running, which other tests cannot have
def chromium() -> Iterator["Browser"]:  # noqa: F821
    """Debian's Chromium with software WebGL, driven by playwright's sync API."""
    from playwright.sync_api import expect, sync_playwright

    from desirepath_experiments.browser.client import installed_browser

    expect.set_options(timeout=PAGE_TIMEOUT_MS)
    executable = installed_browser()
    if executable is None:
        pytest.fail("Chromium is missing; `make test` installs it (scripts/setup_chromium.sh)")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=CHROMIUM_FLAGS, headless=True)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[str]:
    """URL of a PostgreSQL server; skipped where there is none."""
    from tests import postgres

    with postgres.server() as url:
        yield url


@pytest.fixture
def database_of(request: pytest.FixtureRequest) -> Iterator[Callable[[Path], str]]:
    """URL of the database of a data folder: its SQLite file, or a copy of it where tests run on PostgreSQL."""
    from tests import postgres

    if not postgres.ASKED:
        yield lambda folder: f"sqlite:///{folder / 'desirepath.sqlite'}"
        return
    server = request.getfixturevalue("postgres_server")
    with ExitStack() as held:
        yield lambda folder: held.enter_context(postgres.holding(server, folder / "desirepath.sqlite"))


@pytest.fixture(scope="session")
def migrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of an empty, migrated SQLite database, to be copied: all migrations one by one are slow."""
    from desirepath.store.database import Database

    file = tmp_path_factory.mktemp("migrated") / "desirepath.sqlite"
    empty = Database(f"sqlite:///{file}")
    empty.migrate()
    empty.close()
    return file


@pytest.fixture
def database(tmp_path: Path, migrated: Path, database_of: Callable[[Path], str]) -> Iterator["Database"]:  # noqa: F821
    """An empty, migrated database."""
    from desirepath.store.database import Database

    shutil.copy(migrated, tmp_path)
    empty = Database(database_of(tmp_path))
    empty.migrate()
    yield empty
    empty.close()


@pytest.fixture
def files(tmp_path: Path) -> "ArtefactStore":  # noqa: F821
    """An empty artefact store."""
    from desirepath.store.artefacts import ArtefactStore

    return ArtefactStore((tmp_path / "artefacts").as_uri())


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A real disk of 1 MB; skipped where this user may not mount one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("only root can mount a small disk, and only outside of most containers")
    yield folder
    subprocess.run(["umount", "--lazy", folder], check=True)  # a test that failed may still hold a file open
