"""The field's words: names in the code, and what the lab's pages, guides and commands say, in both languages."""

from __future__ import annotations

import io
import re
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

NAMES = re.compile(
    r"_?(told|wants?|tastes?|stakes|calm|mistakes|habits|chances|escapes|explorer|house|pieces|refine(d|ment)?)(_.*)?"
    r"|_?drives?|_?driven|next_drive|drive_seen|restart_drive|Told|Explorer|House|Way|Drives?"
)
"""Our words of before, as names. The field says trajectory, rollout, side, preference weights, conditioned on, lapse
rate, response model, choice probability, reward weights, action smoothness penalty, fine-tuning, conditioning search,
replay collector, recovery policy, services, tasks."""
KERNEL = {
    ("backend/desirepath/simulation/kernels.py", "drive"),
    ("backend/desirepath/simulation/reference.py", "_drive"),
}  # the wheels do

SAID = (  # old, new
    ("told what is wanted", "Preference-conditioned policies"),
    ("served nothing else", "held-out scenes"),
    ("from nothing", "from scratch"),
    ("no policy can better", "hare of the possible improvement"),
    ("undecided which objective", "Uncertainty about the main objective"),
    ("Who did what and when", "Audit log"),
    ("snapshot, the answers", "Training data"),
    ("Take everything away", "Download report"),
    ("A place is held", "Active and completed participants occupy a slot"),
    ("leaves out zero", "95 % CI excludes 0"),
    ("Remarkable", "Flags"),
    ("Schnappsch", "Datenst"),
    ("Pilot oder Ernst", "Pilotphase"),
    ("Wer hat was wann getan", "Audit-Log"),
)


def names_of(path: Path) -> set[str]:
    tokens = tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline)
    return {one.string for one in tokens if one.type == tokenize.NAME}


def test_names_in_the_code_are_the_fields() -> None:
    found = {
        (path.relative_to(ROOT).as_posix(), name)
        for room in ("backend", "app")
        for path in (ROOT / room).rglob("*.py")
        if "migrations" not in path.parts
        for name in names_of(path)
        if NAMES.fullmatch(name)
    }
    assert found - KERNEL == set()


@pytest.fixture(scope="module")
def said() -> str:
    """What lab pages, guides and commands say; participants keep their plain words."""
    rooms = (
        ("frontend/locales", "*.yaml"),
        ("frontend/templates", "*.html"),
        ("docs", "*.md"),
        ("backend/desirepath/cli", "*.py"),
    )
    files = [path for room, pattern in rooms for path in sorted((ROOT / room).rglob(pattern))]
    return "\n".join(path.read_text(encoding="utf-8") for path in [*files, ROOT / "README.md"])


@pytest.mark.parametrize(("old", "new"), SAID)
def test_pages_and_guides_say_it_as_the_field_does(said: str, old: str, new: str) -> None:
    assert old not in said
    assert new in said


def test_german_lab_pages_speak_of_trajectories() -> None:
    """*Fahrt* is the participants' word; log and protocol are two words."""
    for name in ("lab", "analyst", "flow", "operating", "paths", "versions"):
        text = (ROOT / "frontend" / "locales" / "de" / f"{name}.yaml").read_text(encoding="utf-8")
        assert not re.search(r"\bFahrt(en)?\b|\bdrive\b.*:.*\bdrives\b", text), name
        assert not re.search(r"Fassung|Ereignisprotokoll|Änderungsprotokoll", text), name


def test_every_room_says_what_lives_in_it() -> None:
    for package in [ROOT / "app", *(one.parent for one in (ROOT / "backend").rglob("__init__.py"))]:
        first = (package / "__init__.py").read_text(encoding="utf-8")
        assert first.startswith('"""'), package
