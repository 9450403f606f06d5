"""Recordings of three runs past a person, made for every test."""

from pathlib import Path

import pytest

from desirepath.recordings.importing import Imported, import_recordings
from desirepath.recordings.mapping import Mapping, read_mapping
from tests.recordings.walks import csv_of, rows


@pytest.fixture
def hall(tmp_path: Path) -> Path:
    """A CSV with the usual names."""
    file = tmp_path / "hall.csv"
    file.write_text(csv_of("run,who,time_s,x_m,y_m,yaw_rad", rows()))
    return file


@pytest.fixture
def imported(tmp_path: Path):
    """Writes a CSV (and a mapping) and imports it."""

    def of(text: str, mapping: str = "", name: str = "walk.csv", **options) -> Imported:
        file = tmp_path / name
        file.write_text(text)
        found = Mapping()
        if mapping:
            (tmp_path / "mapping.yaml").write_text(mapping)
            found, _ = read_mapping(tmp_path / "mapping.yaml")
        return import_recordings(file, "study_room", found, **options)

    return of
