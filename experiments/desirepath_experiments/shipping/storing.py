"""What somebody asks to be shipped, and how an artefact is stored: a file with a card that says how it was made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from desirepath.installed import DATASETS
from desirepath.learning.cards import DEPARTURES, Card, card_path, file_sha256, source_commit
from desirepath.learning.td3.base import OnProgress, no_progress

QUERIES = 200  # as many as are shipped


@dataclass(frozen=True)
class Request:
    """folder: that the setup's folder lies in. count: of queries, or scenes of triples. work: a folder where trainings
    are kept, to go on with."""

    setup: str
    seed: int = 0
    folder: Path = DATASETS
    count: int = QUERIES
    work: Path | None = None
    on_progress: OnProgress = no_progress

    def path(self, name: str) -> Path:
        """Of an artefact of the setup."""
        return self.folder / self.setup / f"{name}.npz"

    def parents(self, *names: str) -> dict[str, str]:
        """Full name -> sha256 of artefacts of the setup that lie in the folder."""
        return {f"{self.setup}/{name}": file_sha256(self.path(name)) for name in names}

    def store(self, kind: str, name: str, save: Callable[[Path], object] | bytes, command: str, **fields: Any) -> Card:
        """`store` for an artefact of the setup, made with the seed. command: as `ship` is asked."""
        command = f"desirepath ship {command} --seed {self.seed}"
        return store(kind, f"{self.setup}/{name}", save, self.folder, command=command, seed=self.seed, **fields)


def store(kind: str, name: str, save: Callable[[Path], object] | bytes, folder: Path, **fields: Any) -> Card:
    """Write an artefact and its card. save: its bytes, or what writes them; fields: of the card, departures by their
    keys or in sentences; the commit is the source's if it is not among them."""
    path = folder / f"{name}.npz"
    path.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(save, bytes):
        path.write_bytes(save)
    else:
        save(path)
    departures = [DEPARTURES.get(departure, departure) for departure in fields.pop("departures", ())]
    about: dict[str, Any] = {"commit": source_commit(), "config": {}, "scenes": {}, "results": {}, "seed": 0} | fields
    setup = "" if kind == "second_reader" else name.split("/")[0]
    card = Card(kind, name, setup, path.name, file_sha256(path), departures=departures, **about)
    card.save(card_path(path))
    return card
