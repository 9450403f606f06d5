"""What somebody asks to be shipped, and how an artefact is stored: a file with a card that says how it was made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from desirepath.installed import DATASETS
from desirepath.learning.cards import DEPARTURES, Card, card_path, file_sha256, source_commit
from desirepath.learning.td3.base import OnProgress, no_progress
from desirepath.learning.td3.interrupted import TrainingFile

QUERIES = 200  # as many as are shipped


@dataclass(frozen=True)
class Request:
    """folder: that the setup's folder lies in. count: of queries, or scenes of triples. work: a folder where trainings
    are kept, to go on with. report_sets: of so many scenes are policies measured in. command: that makes all of it;
    empty: `desirepath ship`. made_of: what else everything is made of, name -> sha256."""

    setup: str
    seed: int = 0
    folder: Path = DATASETS
    count: int = QUERIES
    work: Path | None = None
    on_progress: OnProgress = no_progress
    report_scenes: int = 2_000
    report_sets: int = 5
    command: str = ""
    made_of: Mapping[str, str] = field(default_factory=dict)

    def path(self, name: str) -> Path:
        """Of an artefact of the setup."""
        return self.folder / self.setup / f"{name}.npz"

    def training_file(self, name: str, settings: dict[str, Any]) -> TrainingFile | None:
        """Where the training of an artefact is on its way, if there is a folder for that."""
        return TrainingFile(self.work / f"{self.setup}_{name}.npz", {**settings, **self.made_of}) if self.work else None

    def parents(self, *names: str) -> dict[str, str]:
        """Full name -> sha256 of artefacts of the setup that lie in the folder."""
        return {f"{self.setup}/{name}": file_sha256(self.path(name)) for name in names}

    def store(self, kind: str, name: str, save: Callable[[Path], object] | bytes, command: str, **fields: Any) -> Card:
        """`store` for an artefact of the setup, made with the seed. command: as `ship` is asked."""
        command = self.command or f"desirepath ship {command} --seed {self.seed}"
        fields["parents"] = {**fields.get("parents", {}), **self.made_of}
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
    setup = "" if kind in ("second_reader", "people_in_general") else name.split("/")[0]
    card = Card(kind, name, setup, path.name, file_sha256(path), departures=departures, **about)
    card.save(card_path(path))
    return card
