"""The house itself: circles, what no file may contain, and that the container files are valid. That imports only go
downwards is import-linter's, in `make lint`, which `make check` and `make test` run as well."""

import ast
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import grimp
import pytest
import yaml

from desirepath_experiments.reachability import unreachable

ROOT = Path(__file__).resolve().parents[1]


def tracked_files() -> list[Path]:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
    return [ROOT / name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file()]


def test_no_files_of_the_product_import_each_other_in_a_circle():
    """All imports count: inside functions, and what only a type checker reads."""
    graph = grimp.build_graph("desirepath", "desirepath_stage", cache_dir=None)
    above = {module: graph.find_upstream_modules(module) for module in graph.modules}
    assert len(above) > 400
    circles = {frozenset({m, *(other for other in above[m] if m in above[other])}) for m in above}
    assert {circle for circle in circles if len(circle) > 1} == KNOWN_CIRCLES


KNOWN_CIRCLES = {
    frozenset(f"desirepath.simulation.{name}" for name in ("setups", "setup_files", "worlds")),
    frozenset({"desirepath.simulation.fast", "desirepath.simulation.crowds.peopled_engine"}),
}
"""A setup's file is read where its name is asked for; `make_engine` makes the subclass that moves pedestrians."""


def test_the_product_names_the_laboratory_in_no_string():
    """Imports are import-linter's; what is imported by a name in a string would pass it."""
    named = re.compile(
        r"""["'.]desirepath_experiments|import_module\((?!"pybullet"|f"\{__name__\}\.|self\.modules\[)"""
    )
    found = [
        f"{file.relative_to(ROOT)}: {match.group()}"
        for room in ("backend", "app")
        for file in (ROOT / room).rglob("*.py")
        for match in named.finditer(file.read_text(encoding="utf-8"))
    ]
    assert not found


def test_the_product_holds_nothing_that_only_the_laboratory_uses():
    left, lines = unreachable()
    assert not left
    assert lines > 50_000


def test_the_product_imports_only_what_its_wheel_asks_for():
    """Development tools are not there in somebody else's environment."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    asked = [*project["dependencies"], *(one for name, more in extras.items() if name != "dev" for one in more)]
    named = {re.split(r"[^A-Za-z0-9._-]", one)[0].lower().replace("_", "-") for one in asked}
    named |= {one.removeprefix("ros-jazzy-") for one in named}  # in an environment of its own
    of_module = packages_distributions()
    imported = {
        (node.module if isinstance(node, ast.ImportFrom) else alias.name).partition(".")[0]
        for room in ("backend", "app")
        for file in (ROOT / room).rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Import) or (isinstance(node, ast.ImportFrom) and node.module and not node.level)
        for alias in node.names
    }
    foreign = {one for one in imported if one not in sys.stdlib_module_names and not one.startswith("desirepath")}
    assert len(foreign) > 20
    lacking = {one for one in foreign if not {d.lower().replace("_", "-") for d in of_module.get(one, [one])} & named}
    assert lacking <= BROUGHT_ALONG


BROUGHT_ALONG = {"annotated_types", "click", "lz4", "pydantic_core", "rcl_interfaces", "typing_extensions"}
"""What a declared requirement asks for itself."""


def test_every_room_says_what_lives_in_it() -> None:
    rooms = [one for top in ("backend", "app", "experiments") for one in (ROOT / top).rglob("__init__.py")]
    assert len(rooms) > 40
    assert [one for one in rooms if not one.read_text(encoding="utf-8").startswith('"""')] == []


def test_no_registry_address_machine_path_or_private_address_in_any_file():
    # Written in pieces so that this file does not find itself.
    leaks = re.compile(
        "|".join(
            [
                r"index-url[ =]+" + "https?:",
                r'"resolved": *"' + "https?:",
                "/(work|farm)" + r"/(main|shared)",
                r"\b192\." + r"168\.\d",
                r"\b10\.\d+\." + r"\d+\.\d+\b",
            ]
        )
    )
    found = []
    for file in tracked_files():
        try:
            text = file.read_text()
        except UnicodeDecodeError:
            continue
        found += [f"{file.relative_to(ROOT)}: {match.group()}" for match in leaks.finditer(text)]
    assert not found


def test_repository_is_lean():
    # The heaviest: the 500 queries of the interface study, 3.5 MB; in sum query sets (9 MB), libraries of policies for
    # people whom the nine objectives do not describe (4 MB), what sentences and pictures are read with (3 MB).
    heavy = [f"{file.relative_to(ROOT)}" for file in tracked_files() if file.stat().st_size > 4_000_000]
    assert not heavy
    assert sum(file.stat().st_size for file in tracked_files()) < 36_000_000


def test_lock_pins_every_package_by_hash_and_leaves_torch_out():
    lock = (ROOT / "requirements.lock").read_text()
    pinned = re.findall(r"^([A-Za-z0-9_.-]+)(?:\[[^\]]*\])?==", lock, re.MULTILINE)
    assert len(pinned) > 100
    assert lock.count("--hash=sha256:") >= len(pinned)
    assert "torch" not in pinned
    assert "http://" not in lock
    assert "https://" not in lock


@pytest.mark.parametrize(
    ("file", "schema", "valid"),
    [
        ("docker-compose.yml", "vendor.compose-spec", True),
        (".github/workflows/containers.yml", "vendor.github-workflows", True),
        (".github/workflows/tests.yml", "vendor.github-workflows", True),
        (".github/ISSUE_TEMPLATE/bug.yml", "vendor.github-issue-forms", True),
        (".github/ISSUE_TEMPLATE/idea.yml", "vendor.github-issue-forms", True),
        ("CITATION.cff", "vendor.citation-file-format", True),
        ("docker-compose.yml", "vendor.github-workflows", False),  # shows that the checker can fail
    ],
)
def test_files_that_others_read_are_valid_against_their_schemas(file, schema, valid):
    checked = subprocess.run(
        [sys.executable, "-m", "check_jsonschema", "--default-filetype", "yaml", "--builtin-schema", schema, file],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert (checked.returncode == 0) == valid, checked.stdout + checked.stderr


def test_compose_file_holds_the_four_services_and_no_secret():
    compose = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
    assert {"web", "worker", "database", "proxy"} <= set(compose["services"])
    for service in compose["services"].values():
        for name, value in service.get("environment", {}).items():
            if "password" in f"{name}={value}".lower():
                assert value == "/run/secrets/database_password", f"{name}: where it is, never what it is"
