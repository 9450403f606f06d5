"""The shipped example study: all of it simulated and marked so, whole wherever it is brought, gone once removed."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import func, select

from desirepath.learning.cards import Card, card_path, file_sha256
from desirepath.learning.policies.policy import Policy
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.artefacts import ArtefactStore, load_artefact, load_trajectory
from desirepath.store.database import Database
from desirepath.store.dataset.writing import export_study
from desirepath.store.example_study import FILE, ExampleError, add_example, example_id, remove_example
from desirepath.store.models import Artefact, Base, Job, Participant, Response, Session, Setting, Study, Trial
from desirepath.store.query_sets import import_query_set
from desirepath.store.shipped_policies import register_shipped
from desirepath.store.snapshots import load_snapshot

Installation = tuple[Database, ArtefactStore]
MOST_BYTES = 300_000


def opened(folder: Path) -> Installation:
    database = Database(f"sqlite:///{folder / 'desirepath.sqlite'}")
    return database, ArtefactStore((folder / "artefacts").as_uri())


@pytest.fixture(scope="module")
def bare(migrated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data folder of an installation with what is shipped, as `desirepath serve --demo` leaves it."""
    folder = tmp_path_factory.mktemp("bare")
    shutil.copyfile(migrated, folder / "desirepath.sqlite")
    database, files = opened(folder)
    with database.transaction() as s:
        register_shipped(s, files)
        import_query_set(s, files, "study_room/queries_varied_200")
    database.close()
    return folder


@pytest.fixture(scope="module")
def brought(bare: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Installation]:
    """Only read it."""
    database, files = opened(shutil.copytree(bare, tmp_path_factory.mktemp("brought") / "data"))
    assert add_example(database, files) is not None
    yield database, files
    database.close()


def rows_of(database: Database) -> dict[str, int]:
    with database.session() as s:
        return {t.name: s.scalar(select(func.count()).select_from(t)) or 0 for t in Base.metadata.sorted_tables}


def test_it_is_small_and_its_card_says_how_it_was_made() -> None:
    card = Card.load(card_path(FILE))
    assert card.sha256 == file_sha256(FILE)
    assert FILE.stat().st_size < MOST_BYTES
    assert card.command == f"desirepath ship example-study study_room --seed {card.seed}"
    assert "Simulated people" in card.notes[0]


def test_everything_of_it_is_marked_as_simulated(brought: Installation, tmp_path: Path) -> None:
    database, files = brought
    with database.session() as s:
        study = s.scalars(select(Study)).one()
        assert (study.state, "simulated" in study.name) == ("closed", True)
        for model in (Participant, Session):
            assert all(s.scalars(select(model.simulated)).all())
        own = s.scalars(select(Artefact).where(Artefact.study_id == study.id)).all()
        assert {"policy", "reward_model", "snapshot", "evaluation"} <= {one.kind for one in own}
        assert all(one.simulated for one in own)
        assert all(code.startswith("S") for code in s.scalars(select(Participant.code)))
        study_id = study.id
    export_study(database, files, study_id, tmp_path / "set")
    assert "simulated" in json.loads((tmp_path / "set" / "study.json").read_text())["name"]
    header, *lines = (tmp_path / "set" / "participants.csv").read_text().splitlines()
    column = header.split(",").index("simulated")
    assert {line.split(",")[column] for line in lines} == {"true"}


def check_whole(database: Database, files: ArtefactStore) -> None:
    """Every trajectory, artefact and answer that a row names is here and is what it is called."""
    with database.session() as s:
        for trial in s.scalars(select(Trial)):
            for name in (trial.trajectory_a, trial.trajectory_b):
                assert load_trajectory(files, name).digest() == name
        kinds = {}
        for artefact in s.scalars(select(Artefact).where(Artefact.study_id.is_not(None))):
            assert load_artefact(s, files, artefact.id)[0] is artefact
            kinds[artefact.kind] = artefact.id
        assert isinstance(Policy.from_bytes(files.get(kinds["policy"])), Policy)
        for answer in load_snapshot(s, files, kinds["snapshot"]).answers:
            assert s.get(Response, answer.response) is not None
            assert files.exists(answer.trajectory_a)
        assert {job.state for job in s.scalars(select(Job))} <= {"succeeded", "cancelled"}


def test_what_was_shown_and_learned_is_here(brought: Installation) -> None:
    check_whole(*brought)


def test_it_is_whole_where_another_compressor_writes_trajectories(
    migrated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """zlib-ng and Apple's write the same arrays as other bytes, so every trajectory has another name there."""
    written = Trajectory.to_bytes
    monkeypatch.setattr(Trajectory, "to_bytes", lambda self: written(self) + b"\0")
    monkeypatch.setattr("desirepath.simulation.trajectory.from_npz", _without_last())
    shutil.copyfile(migrated, tmp_path / "desirepath.sqlite")
    database, files = opened(tmp_path)
    with database.transaction() as s:
        register_shipped(s, files)
    assert add_example(database, files) is not None
    check_whole(database, files)
    database.close()


def _without_last() -> Any:
    from desirepath.npz import from_npz

    return lambda data, bounds: from_npz(data.removesuffix(b"\0"), bounds)


def test_it_comes_once_and_not_again_after_it_was_removed(bare: Path, tmp_path: Path) -> None:
    data = shutil.copytree(bare, tmp_path / "data")
    database, files = opened(data)
    rows, names = rows_of(database), set(files.names())
    study_id = add_example(database, files)
    assert add_example(database, files) is None
    with database.session() as s:
        assert example_id(s) == study_id
        job = s.scalars(select(Job.id)).first()
    log = data / "logs" / f"{job}.log"
    log.parent.mkdir()
    log.write_text("of a job")
    remove_example(database, files, data)
    assert rows_of(database) == rows | {"setting": rows["setting"] + 1}
    assert set(files.names()) == names
    assert not log.exists()
    assert add_example(database, files) is None
    with database.session() as s:
        assert s.scalars(select(Setting)).one().value == {"study": None}
    with pytest.raises(ExampleError):
        remove_example(database, files, data)
    database.close()


def test_it_is_not_removed_where_people_take_part_by_now(bare: Path, tmp_path: Path) -> None:
    data = shutil.copytree(bare, tmp_path / "data")
    database, files = opened(data)
    study_id = add_example(database, files)
    with database.transaction() as s:
        s.add(Participant(study_id=study_id, code="P1"))
    before = rows_of(database)
    with pytest.raises(ExampleError, match="people take part"):
        remove_example(database, files, data)
    assert rows_of(database) == before
    database.close()


def test_another_file_is_refused_and_nothing_is_written(bare: Path, tmp_path: Path) -> None:
    database, files = opened(shutil.copytree(bare, tmp_path / "data"))
    before = rows_of(database)
    (tmp_path / "no.zip").write_bytes(b"no zip")
    with pytest.raises(ExampleError, match="is no example study"):
        add_example(database, files, tmp_path / "no.zip")
    assert rows_of(database) == before
    database.close()
