"""What somebody made to harm is stored and leaves all the same, or is refused before it costs anything."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import re
import shutil
import zipfile
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from sqlalchemy import select, text, update

from desirepath.csv_text import csv_text
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.dataset import reading
from desirepath.store.dataset.columns import CHECKSUMS_FILE
from desirepath.store.dataset.importing import import_dataset
from desirepath.store.dataset.reading import DatasetError, read_dataset
from desirepath.store.dataset.writing import export_study
from desirepath.store.erasure import erase_participant
from desirepath.store.events import log_event
from desirepath.store.models import Event, Study
from desirepath.store.plain_data import (
    CUT,
    LARGEST_JSON,
    MOST_LEVELS,
    TOO_DEEP,
    Unstorable,
    copy_data,
    dump_json,
    levels_of,
    load_json,
    mentions,
)
from tests.store.small_study import SmallStudy, trajectory


def nested(levels: int, inside: str) -> Any:
    found: Any = inside
    for k in range(levels):
        found = [found] if k % 2 else {"in": found}
    return found


def insert_event(study: SmallStudy, session: str, kind: str, data: str) -> None:
    """As only another program could have written it."""
    with study.database.engine.begin() as connection:
        connection.execute(
            text(
                "INSERT INTO event (at, study_id, session_id, kind, data) VALUES (:at, :study, :session, :kind, :data)"
            ),
            {
                "at": datetime(2026, 11, 2, tzinfo=UTC),
                "study": study.id,
                "session": session,
                "kind": kind,
                "data": data,
            },
        )


@pytest.mark.parametrize("levels", [MOST_LEVELS + 1, 450, 900, 5000])
def test_no_column_takes_json_that_could_not_be_read_again(study: SmallStudy, levels: int):
    _, session = study.participant("P1")
    with pytest.raises(Unstorable, match=str(MOST_LEVELS)), study.database.transaction() as s:
        log_event(s, "page_script_error", session_id=session, page=nested(levels - 1, "P1"))
    with pytest.raises(Unstorable, match=str(MOST_LEVELS)), study.database.transaction() as s:
        s.execute(update(Study).values(protocol=nested(levels, "P1")))
    with study.database.transaction() as s:
        log_event(s, "page_script_error", session_id=session, page=nested(MOST_LEVELS - 1, "P1"))
    with pytest.raises(Unstorable, match="bytes"):
        dump_json("x" * LARGEST_JSON)


@pytest.mark.parametrize("levels", [450, 900])
def test_an_event_of_any_depth_leaves_with_the_study_and_lets_others_be_erased(
    study: SmallStudy, tmp_path: Path, levels: int
):
    """One participant's request was stored; then the export failed and nobody else could be erased."""
    person, _ = study.participant("P1")
    other, session = study.participant("P2", drives=100)
    insert_event(study, session, "page_script_error", json.dumps({"page": nested(levels, "P1")}))
    export_study(study.database, study.files, study.id, tmp_path / "out")
    (told,) = [
        row["data"]
        for row in pq.read_table(tmp_path / "out" / "events.parquet").to_pylist()
        if row["kind"] == "page_script_error"
    ]
    assert CUT in told
    assert levels_of(json.loads(told)) == MOST_LEVELS
    assert read_dataset(tmp_path / "out").about.study == study.id
    erase_participant(study.database, study.files, person, "tester")  # it mentions them, so it goes as well
    with study.database.session() as s:
        assert "page_script_error" not in set(s.scalars(select(Event.kind)))
    erase_participant(study.database, study.files, other, "tester")


def test_an_event_too_deep_for_python_is_read_by_its_words(study: SmallStudy, tmp_path: Path):
    _, session = study.participant("P1")
    insert_event(study, session, "x", '{"in":' * 20_000 + '"P1"' + "}" * 20_000)
    with study.database.session() as s:
        found = s.scalars(select(Event.data).where(Event.kind == "x")).one()
    assert mentions(found, {"P1"})
    assert set(found) == {TOO_DEEP}
    export_study(study.database, study.files, study.id, tmp_path / "out")


def test_plain_data_are_copied_in_order_without_what_must_not_leave():
    given = {"b": [1, {"token": "x", "a": "y"}, []], "a": None, "deep": nested(5, "z")}
    allowed = copy_data(given, text=str.upper, without=lambda key, _: key == "token", most_levels=3)
    assert list(allowed) == ["b", "a", "deep"]
    assert allowed == {"b": [1, {"a": "Y"}, []], "a": None, "deep": {"in": [CUT]}}
    assert copy_data("alone") == "alone"
    assert load_json('{"a": [1]}') == {"a": [1]}


@pytest.mark.parametrize("secret", ["fine\r=1+1", "fine\r\n@SUM(A1)", "\r=1+1", "two\n-1", "\t=1", '"quoted",\r+1'])
def test_no_text_begins_a_row_or_a_formula(study: SmallStudy, tmp_path: Path, secret: str):
    study.participant("P1", secret=secret)
    export_study(study.database, study.files, study.id, tmp_path / "out")
    content = (tmp_path / "out" / "questionnaire_items.csv").read_bytes().decode()
    assert "\r" not in content
    assert not [line for line in content.splitlines() if line.startswith(("=", "+", "-", "@", "\t"))]
    rows = list(csv.DictReader(io.StringIO(content, newline="")))
    assert len(rows) == 5
    (remark,) = [row["answer"] for row in rows if row["item"] == "remark"]
    lines = secret.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    assert [line.removeprefix("'") for line in remark.removeprefix("'").split("\n")] == lines
    exact = [row["answer"] for row in pq.read_table(tmp_path / "out" / "questionnaire_items.parquet").to_pylist()]
    assert secret in exact


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("=1+1", "'=1+1"),
        ("fine;=1+1", "fine;'=1+1"),
        ("fine; @SUM(A1)", "fine;' @SUM(A1)"),
        ("\uff1d1+1", "'\uff1d1+1"),
        ("a\u2028-b", "a\u2028'-b"),
        ("-0.5", "-0.5"),
        ("+1e3", "+1e3"),
        ("-", "'-"),
        ("a - b = c", "a - b = c"),
    ],
)
def test_no_cell_is_a_formula_for_any_spreadsheet_and_numbers_stay_numbers(text, written):
    assert next(csv.reader([csv_text([[text, -1.5, None]])])) == [written, "-1.5", ""]


def test_every_list_that_leaves_as_csv_is_written_in_one_place():
    """The other one is for platforms, which take ids as they are; `is_id` stands before it."""
    root = Path(__file__).resolve().parents[2]
    found = {
        str(file.relative_to(root))
        for room in ("backend", "app")
        for file in (root / room).rglob("*.py")
        if re.search(r"csv\.(DictW|w)riter|to_csv\(", file.read_text())
    }
    assert found == {"backend/desirepath/csv_text.py", "backend/desirepath/web/lab/payments.py"}


# ---- data sets from elsewhere ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hostile")
    database = Database(f"sqlite:///{folder / 'desirepath.sqlite'}")
    database.migrate()
    study = SmallStudy(database, ArtefactStore((folder / "artefacts").as_uri()))
    study.participant("P1")
    export_study(database, study.files, study.id, folder / "out")
    return folder / "out"


@pytest.fixture
def changed(exported: Path, tmp_path: Path) -> Path:
    return shutil.copytree(exported, tmp_path / "changed")


def forge(folder: Path, name: str, content: bytes) -> None:
    """Change or add a file together with its checksum."""
    (folder / name).write_bytes(content)
    lines = [line for line in (folder / CHECKSUMS_FILE).read_text().splitlines() if line[66:] != name]
    lines.append(f"{hashlib.sha256(content).hexdigest()}  {name}")
    (folder / CHECKSUMS_FILE).write_text("".join(f"{line}\n" for line in lines))


def refused(folder: Path, tmp_path: Path) -> str:
    there = Database(f"sqlite:///{tmp_path / 'there.sqlite'}")
    there.migrate()
    with pytest.raises(DatasetError) as no:
        import_dataset(there, ArtefactStore((tmp_path / "there").as_uri()), folder)
    with there.session() as s:
        assert s.scalars(select(Study)).all() == []
    return str(no.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a.update(study="../../../evil"), "study.json: study = '../../../evil'"),
        (lambda a: a.update(study="A" * 32), "study.json: study"),
        (lambda a: a.update(name="x" * 300), "study.json: name"),
        (lambda a: a.update(seed=10**30), "study.json: seed"),
        (lambda a: a["protocol"].update(name='x"; filename="evil.exe'), "study.json: protocol.name"),
        (lambda a: a.update(created_at="yesterday"), "study.json: created_at"),
        (lambda a: a.update(protocol_versions=[{"number": "../../x"}]), "study.json: protocol_versions.0"),
        (lambda a: a.pop("erased_participants"), "study.json: erased_participants"),
        (lambda a: a.update(name=nested(200, "x")), "nests deeper"),
    ],
)
def test_what_study_json_says_is_checked(
    changed: Path, tmp_path: Path, change: Callable[[dict[str, Any]], object], message: str
):
    about = json.loads((changed / "study.json").read_text())
    change(about)
    forge(changed, "study.json", json.dumps(about).encode())
    assert message in refused(changed, tmp_path)


def rewritten(folder: Path, table: str, change: Callable[[dict[str, Any]], object]) -> None:
    found = pq.read_table(folder / f"{table}.parquet")
    rows = found.to_pylist()
    for row in rows:
        change(row)
    out = pa.BufferOutputStream()
    pq.write_table(pa.Table.from_pylist(rows, schema=found.schema), out)
    forge(folder, f"{table}.parquet", out.getvalue().to_pybytes())


@pytest.mark.parametrize(
    ("table", "change", "message"),
    [
        ("trajectories", lambda row: row.update(trajectory="../../evil"), "trajectory = '../../evil'"),
        ("trials", lambda row: row.update(trajectory_a="../../evil"), "trials.parquet: trajectory_a"),
        ("participants", lambda row: row.update(participant="../P1"), "participants.parquet: participant"),
        ("sessions", lambda row: row.update(session="a" * 33), "sessions.parquet: session"),
        ("responses", lambda row: row.update(value="["), "responses.parquet: value = '[' is no JSON"),
        ("responses", lambda row: row.update(value=json.dumps(nested(100, "x"))), "responses.parquet: value: nests"),
        ("events", lambda row: row.update(data="[" * 100_000), "events.parquet: data"),
        ("events", lambda row: row.update(data="[1]"), "events.parquet: data = '[1]': must be a JSON object"),
        ("responses", lambda row: row.update(value=None), "responses.parquet: value is missing"),
        ("planned_steps", lambda row: row.update(planned='{"key": 1}'), "has a plan that is none of ours"),
    ],
)
def test_ids_are_ours_and_json_is_shallow(
    changed: Path, tmp_path: Path, table: str, change: Callable[[dict[str, Any]], object], message: str
):
    rewritten(changed, table, change)
    assert message in refused(changed, tmp_path)


def test_a_small_file_does_not_become_gigabytes(changed: Path, tmp_path: Path):
    """A table of a million equal texts, and arrays of zeros, pack into kilobytes."""
    events = pq.read_table(changed / "events.parquet")
    same = pa.array([0] * 5_000, pa.int32())
    many = events.take(same)
    long = pa.DictionaryArray.from_arrays(same, pa.array(["x" * 1_000_000]))
    many = many.set_column(many.column_names.index("kind"), "kind", long)
    out = pa.BufferOutputStream()
    pq.write_table(many, out, store_schema=False)
    forge(changed, "events.parquet", out.getvalue().to_pybytes())
    assert (changed / "events.parquet").stat().st_size < 200_000
    assert "larger than 1024 MB when it is unpacked" in refused(changed, tmp_path)


def test_a_table_has_so_many_rows_at_most(changed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(reading, "MOST_ROWS", 3)
    assert "rows, at most 3 are read" in refused(changed, tmp_path)


def test_arrays_are_not_unpacked_before_their_hash_was_checked(changed: Path, tmp_path: Path):
    whole = trajectory(0).to_bytes()
    packed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(whole)) as npz, zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as bomb:
        for name in npz.namelist():
            if name == "poses.npy":
                with bomb.open(name, "w", force_zip64=True) as member:
                    np.lib.format.write_array_header_1_0(
                        member, {"descr": "<f4", "fortran_order": False, "shape": (70_000_000, 3)}
                    )
                    for _ in range(84):
                        member.write(bytes(10_000_000))
            else:
                bomb.writestr(name, npz.read(name))
    content = packed.getvalue()
    assert len(content) < 2_000_000
    name = trajectory(0).digest()
    forge(changed, f"trajectories/{name}.npz", content)
    assert "holds another trajectory than its name says" in refused(changed, tmp_path)
    true_name = hashlib.sha256(content).hexdigest()
    forge(changed, f"trajectories/{true_name}.npz", content)
    rewritten(changed, "trajectories", lambda row: row.update(trajectory=true_name))
    assert f"trajectories/{true_name}.npz: is no trajectory" in refused(changed, tmp_path)
