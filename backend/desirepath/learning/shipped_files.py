"""Which artefacts lie in the setups' folders, where their files lie and what their cards say (`open_field/base`).

Reads names and cards only, so that a server that starts need not load the simulator: opening the files is
`policies/shipped.py`'s.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from desirepath.learning.cards import Card, card_path
from desirepath.learning.errors import LearningError
from desirepath.simulation.setups import setup_folders


def _shipped() -> Iterator[tuple[str, Path]]:
    """Name and file of every artefact with a card."""
    for setup, folder in setup_folders().items():
        for path in folder.glob("**/*.npz"):
            if card_path(path).is_file():
                yield f"{setup}/{path.relative_to(folder).with_suffix('').as_posix()}", path


def shipped_names() -> list[str]:
    """Names of everything shipped, sorted."""
    return sorted(name for name, _ in _shipped())


def resolve(name_or_path: str) -> Path:
    """The file behind a shipped name or a path. Raises LearningError naming what is shipped."""
    path = Path(name_or_path)
    if path.is_file():
        return path
    found = dict(_shipped()).get(name_or_path)
    if found is not None:
        return found
    raise LearningError(f"{name_or_path!r} is neither a file nor shipped; shipped are: {', '.join(shipped_names())}")


def load_card(name_or_path: str) -> Card:
    """The card beside an artefact."""
    return Card.load(card_path(resolve(name_or_path)))
