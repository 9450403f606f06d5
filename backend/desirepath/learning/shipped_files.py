"""Which artefacts are shipped, where their files lie and what their cards say (`open_field/base`).

Reads names and cards only, so that a server that starts need not load the simulator: opening the files is
`policies/shipped.py`'s.
"""

from __future__ import annotations

from pathlib import Path

from desirepath.installed import DATASETS
from desirepath.learning.cards import Card, card_path
from desirepath.learning.errors import LearningError


def shipped_names() -> list[str]:
    """Names of everything shipped, sorted."""
    return sorted(path.relative_to(DATASETS).with_suffix("").as_posix() for path in DATASETS.glob("*/**/*.npz"))


def resolve(name_or_path: str) -> Path:
    """The file behind a shipped name or a path. Raises LearningError naming what is shipped."""
    path = Path(name_or_path)
    if path.is_file():
        return path
    if name_or_path in shipped_names():
        return DATASETS / f"{name_or_path}.npz"
    raise LearningError(f"{name_or_path!r} is neither a file nor shipped; shipped are: {', '.join(shipped_names())}")


def load_card(name_or_path: str) -> Card:
    """The card beside an artefact."""
    return Card.load(card_path(resolve(name_or_path)))
