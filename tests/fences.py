"""The code fences of README and docs, for the tests that run them; `test_fences.py` sees that none is left out."""

from __future__ import annotations

import re
import tomllib
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from desirepath.installed import DATASETS, DOCS, ROOT

NOTEBOOK = ROOT / "experiments" / "notebook"
DOCUMENTS = (ROOT / "README.md", DATASETS / "README.md", *sorted(DOCS.glob("*.md")), *sorted(NOTEBOOK.glob("*.md")))
FENCE = re.compile(r'^```(\w*)(?: title="([^"]+)")?\n(.*?)^```$', re.MULTILINE | re.DOTALL)
HEADING = re.compile(r"^## (.+)$", re.MULTILINE)


@dataclass(frozen=True)
class Fence:
    """file: its title, a file to write or one of the source that it belongs into."""

    document: str
    section: str
    language: str
    file: str
    text: str


def fences_of(document: str = "", section: str = "", language: str = "") -> list[Fence]:
    """Those of a document, section and language, or all."""
    found = []
    for path in DOCUMENTS:
        name = path.relative_to(ROOT).as_posix()
        parts = HEADING.split(path.read_text("utf-8"))
        for title, part in zip(["", *parts[1::2]], parts[::2], strict=True):
            found += [Fence(name, title, *fence) for fence in FENCE.findall(part)]
    asked = (document, section, language)
    given = [(one, (one.document, one.section, one.language)) for one in found]
    return [one for one, has in given if all(wanted in ("", place) for wanted, place in zip(asked, has, strict=True))]


def install(fences: list[Fence], folder: Path) -> None:
    """Write the files that fences name below the folder, with what an installer makes of `pyproject.toml`."""
    groups = defaultdict[str, list[str]](list)
    for fence in fences:
        if fence.file == "pyproject.toml":
            for group, entries in tomllib.loads(fence.text)["project"]["entry-points"].items():
                groups[group] += [f"{name} = {place}" for name, place in entries.items()]
        elif fence.file:
            (folder / fence.file).parent.mkdir(parents=True, exist_ok=True)
            (folder / fence.file).write_text(fence.text, "utf-8")
    about = folder / "lab-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: lab\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "".join(f"[{group}]\n" + "\n".join(entries) + "\n" for group, entries in groups.items())
    )
