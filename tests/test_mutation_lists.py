"""The lists that mutation runs go by still speak of the sources as they are."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[1] / "scripts"


@pytest.fixture
def changes(monkeypatch: pytest.MonkeyPatch) -> object:
    monkeypatch.syspath_prepend(str(SCRIPTS))
    import mutation_changes

    yield mutation_changes
    del sys.modules["mutation_changes"]


def test_changes_that_once_nothing_noticed_can_still_be_made(changes: object) -> None:
    for name, (file, there, instead) in changes.NAMED.items():  # type: ignore[attr-defined]
        source = (changes.ROOT / file).read_text(encoding="utf-8")  # type: ignore[attr-defined]
        assert source.count(there) == 1, name
        compile(source.replace(there, instead), file, "exec")


def test_every_change_that_counts_for_nothing_is_one_that_can_be_made_and_says_why(changes: object) -> None:
    listed = json.loads((SCRIPTS / "mutation_equivalent.json").read_text(encoding="utf-8"))
    made = set()
    lines: dict[str, list[str]] = {}
    for one in changes.mutants():  # type: ignore[attr-defined]
        source = lines.setdefault(one.file, (changes.ROOT / one.file).read_text(encoding="utf-8").splitlines())  # type: ignore[attr-defined]
        made.add((one.file, source[one.line - 1].strip(), one.change))
    gone = [one for one in listed if (one["file"], one["line"], one["change"]) not in made]
    assert gone == []
    assert all(len(one["why"]) > 20 for one in listed)
