"""A study leaves as a data set that is complete, marked and safe to share, and comes back to the same answers."""

from __future__ import annotations

import csv
import hashlib
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from sqlalchemy import select, update

from desirepath.store.artefacts import ArtefactError, ArtefactStore
from desirepath.store.database import Database
from desirepath.store.dataset.columns import CHECKSUMS_FILE
from desirepath.store.dataset.descriptions import data_dictionary
from desirepath.store.dataset.importing import import_dataset
from desirepath.store.dataset.reading import DatasetError
from desirepath.store.dataset.tables import TABLES
from desirepath.store.dataset.writing import ExportError, export_study
from desirepath.store.events import log_event
from desirepath.store.models import Participant, RecruitingId, Response, Session, Study, Trial, protocol_digest, utc_now
from desirepath.store.snapshots import load_snapshot, take_snapshot
from tests.store.small_study import FILES, PROTOCOL_YAML, SmallStudy, trajectory

WITHDRAWN_DRIVES = 200
FORMULA = '=HYPERLINK("http://evil.example","click")'


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> SmallStudy:
    """Three people and a bot; one excluded, one withdrawn; free text that a spreadsheet would run. Only read it.

    One of the recruiting ids is `regular`, which is also a word of ours and an option of the questionnaire.
    """
    folder = tmp_path_factory.mktemp("full")
    database = Database(f"sqlite:///{folder / 'desirepath.sqlite'}")
    database.migrate()
    study = SmallStudy(database, ArtefactStore((folder / "artefacts").as_uri()))
    _, session = study.participant("P1", secret=FORMULA)
    excluded, _ = study.participant("P2", choices="bb", drives=100)
    withdrawn, left = study.participant("P3", choices="ab", drives=WITHDRAWN_DRIVES, secret="told in confidence")
    study.participant("bot", choices="aa", drives=300, simulated=True)
    with database.transaction() as s:
        s.get(Participant, excluded).excluded_at = utc_now()
        s.get(Participant, excluded).excluded_reason = "-asleep"
        s.get(Participant, withdrawn).withdrawn_at = utc_now()
        s.get(Participant, withdrawn).excluded_reason = "told in confidence"
        s.get(Session, left).state = "withdrawn"
        s.get(RecruitingId, excluded).external_id = "regular"
        elsewhere = {"width": 800}
        log_event(s, "device_checked", session_id=session, before=s.get(Session, session).device, after=elsewhere)
        s.get(Session, session).device = elsewhere
        log_event(s, "opened", session_id=session, address="/join?PROLIFIC_PID=prolific-P1-" + FORMULA)
        s.execute(
            update(Trial)
            .where(Trial.step_key == "trial-4")
            .values(kind="comparison", arms={"a": "base", "b": "own", "own": "b", "look_alike": True})
        )
    return study


@pytest.fixture(scope="module")
def exported(full: SmallStudy, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its data set. Only read it."""
    folder = tmp_path_factory.mktemp("exported") / "out"
    export_study(full.database, full.files, full.id, folder)
    return folder


@pytest.fixture
def copied(exported: Path, tmp_path: Path) -> Path:
    """A copy of the data set to do harm to."""
    return shutil.copytree(exported, tmp_path / "copied")


def csv_rows(folder: Path, table: str) -> list[dict[str, str]]:
    with (folder / f"{table}.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def parquet_rows(folder: Path, table: str) -> list[dict[str, object]]:
    return pq.read_table(folder / f"{table}.parquet").to_pylist()


def test_the_tables_hold_every_row_with_its_marks(exported: Path):
    people = {row["participant"]: row for row in parquet_rows(exported, "participants")}
    assert list(people) == ["P1", "P2", "P3", "bot"]
    assert [name for name, row in people.items() if row["excluded"]] == ["P2"]
    assert [name for name, row in people.items() if row["withdrawn"]] == ["P3"]
    assert [name for name, row in people.items() if row["simulated"]] == ["bot"]
    assert json.loads(people["bot"]["oracle"]) == {"name": "min-human-distance", "noise": 0.0}
    responses = parquet_rows(exported, "responses")
    assert len(responses) == 3 * 2 + 4 + 2 + 2  # learning trial and questionnaire each, and the answers
    assert sum(row["practice"] for row in responses) == 3
    assert {row["participant"] for row in responses if row["excluded"]} == {"P2"}
    first = next(row for row in responses if row["participant"] == "P1" and row["step"] == "trial-1")
    assert (first["choice"], first["view"], first["decision_s"]) == ("a", "top_down", 1.25)
    assert first["created_at"].isoformat() == "2026-11-02T09:30:19+00:00"
    sessions = parquet_rows(exported, "sessions")
    assert json.loads(sessions[0]["device"]) == {"width": 800}
    assert len(parquet_rows(exported, "trials")) == 11
    comparison = [row for row in parquet_rows(exported, "trials") if row["kind"] == "comparison"]
    assert [(json.loads(row["arms"])["own"], row["look_alike"]) for row in comparison] == [("b", True)]
    items = [row for row in parquet_rows(exported, "questionnaire_items") if row["participant"] == "P2"]
    assert {row["item"]: (row["answer"], row["answer_number"]) for row in items} == {
        "age": ("44", 44.0),
        "remark": ("fine", None),
        "presence": ("6", 6.0),
        "taste": ("regular", None),
        "devices": ('["tablet", "laptop"]', None),
    }
    events = parquet_rows(exported, "events")
    assert [row["number"] for row in events] == list(range(1, len(events) + 1))


def test_csv_and_parquet_say_the_same(exported: Path):
    for table in TABLES:
        if not table.csv:
            continue
        exact, readable = parquet_rows(exported, table.name), csv_rows(exported, table.name)
        assert len(exact) == len(readable)
        for row, text in zip(exact, readable, strict=True):
            for column in table.columns:
                value, cell = row[column.name], text[column.name]
                if value is None:
                    assert cell == ""
                elif isinstance(value, bool):
                    assert cell == str(value).lower()
                elif isinstance(value, int | float):
                    assert float(cell) == value
                elif isinstance(value, str):
                    assert cell in (value, f"'{value}")


def test_pairs_are_chosen_and_rejected_drives(exported: Path):
    pairs = [row for row in parquet_rows(exported, "pairs") if row["participant"] == "P1" and not row["practice"]]
    assert [row["chosen_shown"] for row in pairs] == ["first", "second", "first", "second"]
    assert pairs[0]["chosen"] == trajectory(2).digest()
    assert pairs[0]["rejected"] == trajectory(3).digest()
    assert pairs[1]["chosen"] == trajectory(5).digest()
    assert [row["kind"] for row in pairs] == ["query", "query", "query", "comparison"]
    assert {row["source"] for row in parquet_rows(exported, "pairs") if row["participant"] == "bot"} == {"simulated"}


def test_trajectories_come_with_states_actions_rewards_and_scene(exported: Path):
    drive = trajectory(3)
    row = next(r for r in parquet_rows(exported, "trajectories") if r["trajectory"] == drive.digest())
    assert (row["outcome"], row["steps"], row["setup"]) == ("success", 6, "study_room")
    assert json.loads(row["scene"]) == json.loads(json.dumps(drive.scene.as_dict()))
    steps = [r for r in parquet_rows(exported, "trajectory_steps") if r["trajectory"] == drive.digest()]
    assert np.allclose([[r["x_m"], r["y_m"], r["yaw_rad"]] for r in steps], drive.poses[:-1])
    assert np.allclose([[r["next_x_m"], r["next_y_m"], r["next_yaw_rad"]] for r in steps], drive.poses[1:])
    assert np.array_equal(np.array([r["observation"] for r in steps], dtype=np.float32), drive.observations)
    assert np.array_equal(np.array([r["next_observation"] for r in steps], dtype=np.float32), drive.next_observations)
    assert np.allclose([[r["action_linear"], r["action_angular"]] for r in steps], drive.actions)
    assert np.allclose([r["reward"] for r in steps], drive.rewards)
    assert [r["done"] for r in steps] == drive.dones.tolist()
    assert (exported / "trajectories" / f"{drive.digest()}.npz").read_bytes() == drive.to_bytes()


def test_the_study_file_names_protocol_licence_citation_and_units(exported: Path):
    about = json.loads((exported / "study.json").read_text())
    assert about["licence"] == "CC-BY-4.0"
    assert "Passing people" in about["citation"]
    assert about["protocol"]["sha256"] == protocol_digest(PROTOCOL_YAML, FILES)
    copy = (exported / "protocol" / "protocol.yaml").read_bytes().decode()
    assert copy == PROTOCOL_YAML.replace("PAID-1", '"REMOVED"')
    assert about["protocol"]["written_sha256"] == protocol_digest(copy, FILES)
    layout = about["setups"]["study_room"]["observation_layout"]
    assert layout[0] == {"name": "goal_distance", "unit": "m", "divided_by": 10.0}
    assert len(layout) == len(parquet_rows(exported, "trajectory_steps")[0]["observation"])
    assert (exported / "protocol" / "protocol.yaml").read_bytes().startswith(b"protocol: quick_preference_study\r\n")
    assert (exported / "protocol" / "texts" / "information.md").read_text() == "# Über diese Studie\n"


def test_every_answer_has_the_device_it_was_given_on(exported: Path):
    """P1 went on with another device after the last answer."""
    (session,) = (row for row in parquet_rows(exported, "sessions") if row["participant"] == "P1")
    assert json.loads(session["device"]) == {"width": 800}
    widths = {json.loads(row["device"])["width"] for row in parquet_rows(exported, "responses")}
    assert widths == {1280}


def test_what_identifies_a_person_does_not_leave(full: SmallStudy, exported: Path):
    with full.database.session() as s:
        tokens = s.scalars(select(Study.recruiting_token)).all() + s.scalars(select(Session.token_hash)).all()
        people = s.scalars(select(Participant.id)).all()
    secret = [*tokens, *people, "prolific-", "recruiter-study-1", "done-P1", "user_agent", "Browser ", "PAID-1"]
    found = [
        (path.name, word)
        for path in exported.rglob("*")
        if path.is_file()
        for word in secret
        if word.encode() in path.read_bytes()
    ]
    for table in TABLES:  # Parquet is compressed: look inside
        found += [(table.name, w) for row in parquet_rows(exported, table.name) for w in secret if w in str(row)]
    assert found == []
    opened = next(row for row in parquet_rows(exported, "events") if row["kind"] == "opened")
    assert json.loads(opened["data"]) == {"address": "/join?PROLIFIC_PID=[removed]"}


def test_who_withdrew_is_one_row_without_content(full: SmallStudy, exported: Path):
    with full.database.session() as s:
        person = s.scalars(select(Participant).where(Participant.code == "P3")).one()
        session = s.scalars(select(Session.id).where(Session.participant_id == person.id)).one()
        answers = s.scalars(select(Response.id).where(Response.session_id == session)).all()
    row = next(row for row in parquet_rows(exported, "participants") if row["participant"] == "P3")
    assert row == {
        "participant": "P3",
        "simulated": False,
        "excluded": False,
        "pilot": False,
        "withdrawn": True,
        "training": None,
        "open_data": None,
        "oracle": None,
        "created_at": person.created_at,
        "withdrawn_at": person.withdrawn_at,
        "excluded_at": None,
        "excluded_reason": None,
    }
    drives = [trajectory(WITHDRAWN_DRIVES + k).digest() for k in range(6)]
    traces = [session, *answers, *drives, "told in confidence", "P3"]
    found = {}
    for table in TABLES:
        rows = [str(row) for row in parquet_rows(exported, table.name)]
        found |= {(table.name, trace): 1 for row in rows for trace in traces if trace in row}
    assert found == {("participants", "P3"): 1}
    assert not [drive for drive in drives if (exported / "trajectories" / f"{drive}.npz").exists()]
    for path in exported.rglob("*"):
        assert not path.is_file() or "told in confidence" not in path.read_bytes().decode(errors="replace"), path


def test_pilot_participants_are_in_a_data_set_only_where_they_are_asked_for(study: SmallStudy, tmp_path: Path):
    study.participant("P1")
    _, session = study.participant("P2", pilot=True, drives=100, secret="from the pilot")
    with study.database.transaction() as s:
        log_event(s, "participant_excluded", study_id=study.id, participant="P2")
    export_study(study.database, study.files, study.id, tmp_path / "live")
    rows = [str(row) for table in TABLES for row in parquet_rows(tmp_path / "live", table.name)]
    assert not [row for row in rows for trace in (session, "P2", "from the pilot") if trace in row]
    export_study(study.database, study.files, study.id, tmp_path / "all", pilots=True)
    marked = {row["participant"]: row["pilot"] for row in parquet_rows(tmp_path / "all", "participants")}
    assert marked == {"P1": False, "P2": True}
    there = Database(f"sqlite:///{tmp_path / 'there.sqlite'}")
    there.migrate()
    import_dataset(there, ArtefactStore((tmp_path / "files").as_uri()), tmp_path / "all")
    with there.session() as s:
        assert dict(s.execute(select(Participant.code, Participant.pilot)).all()) == marked


def test_recruiting_ids_are_removed_from_free_text_and_from_nothing_else(study: SmallStudy, tmp_path: Path):
    person, session = study.participant("P1", secret="I am top_down, they call me regular")
    with study.database.transaction() as s:
        s.get(RecruitingId, person).external_id = "regular"
        s.get(RecruitingId, person).details = {"STUDY_ID": "top_down"}
        s.get(Participant, person).excluded_reason = "regular came twice"
        s.get(Session, session).plan = [{"key": "regular", "kind": "trial", "view": "top_down"}]
        log_event(s, "page_script_error", session_id=session, step="regular", page={"text": "at /join?pid=regular"})
    export_study(study.database, study.files, study.id, tmp_path / "out")
    rows = {table.name: parquet_rows(tmp_path / "out", table.name) for table in TABLES}
    assert {row["view"] for row in rows["trials"]} == {"top_down"}
    assert [row["role"] for row in rows["trials"]] == ["practice"] + ["regular"] * 4
    (planned,) = rows["planned_steps"]
    assert json.loads(planned["planned"]) == {"key": "regular", "kind": "trial", "view": "top_down"}
    assert (planned["step"], planned["view"]) == ("regular", "top_down")
    assert rows["participants"][0]["excluded_reason"] == "[removed] came twice"
    items = {row["item"]: row["answer"] for row in rows["questionnaire_items"]}
    assert items["taste"] == "regular"
    assert items["remark"] == "I am [removed], they call me [removed]"
    given = next(row for row in rows["responses"] if row["kind"] == "questionnaire")
    assert json.loads(given["value"]) == {
        "age": 44,
        "presence": 6,
        "taste": "regular",
        "devices": ["tablet", "laptop"],
        "remark": items["remark"],
    }
    event = next(row for row in rows["events"] if row["kind"] == "page_script_error")
    assert json.loads(event["data"]) == {"step": "regular", "page": {"text": "at /join?pid=[removed]"}}


def test_no_cell_starts_a_formula(exported: Path):
    cells = [
        cell
        for path in exported.glob("*.csv")
        for row in csv.reader(path.open(encoding="utf-8", newline=""))
        for cell in row
    ]
    assert f"'{FORMULA}" in cells
    assert "'-asleep" in cells
    dangerous = [
        c for c in cells if c.startswith(("=", "+", "@", "\t", "\r", "\n")) or (c[:1] == "-" and not number(c))
    ]
    assert dangerous == []


def number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def test_checksums_cover_every_file_and_are_what_the_command_says(full: SmallStudy, exported: Path, tmp_path: Path):
    checked = subprocess.run(["sha256sum", "-c", CHECKSUMS_FILE], cwd=exported, capture_output=True, text=True)
    assert checked.returncode == 0, checked.stdout
    said = export_study(full.database, full.files, full.id, tmp_path / "again")
    present = {path.relative_to(exported).as_posix() for path in exported.rglob("*") if path.is_file()}
    assert {file["path"] for file in said["files"]} == present
    by_name = {file["path"]: file for file in said["files"]}
    assert by_name["responses.csv"]["rows"] == len(csv_rows(exported, "responses"))
    for name, file in by_name.items():  # the same data give the same bytes
        assert hashlib.sha256((exported / name).read_bytes()).hexdigest() == file["sha256"], name


def test_an_export_comes_back_to_the_same_answers(full: SmallStudy, exported: Path, tmp_path: Path, either: Database):
    there, their_files = either, ArtefactStore((tmp_path / "there").as_uri())
    there.migrate()
    said = import_dataset(there, their_files, exported)
    assert said == {"study": full.id, "participants": 4, "sessions": 3, "responses": 14, "trajectories": 22}
    export_study(there, their_files, full.id, tmp_path / "back")
    for table in TABLES:
        assert parquet_rows(tmp_path / "back", table.name) == parquet_rows(exported, table.name), table.name
    assert (tmp_path / "back" / "study.json").read_bytes() == (exported / "study.json").read_bytes()
    with full.database.session() as here, there.session() as s:
        assert s.get(Study, full.id).state == "closed"
        same = select(Response.id, Response.value, Response.created_at).order_by(Response.id)
        kept = here.execute(same.join(Session).where(Session.state != "withdrawn")).all()
        assert s.execute(same).all() == kept
        assert s.scalars(select(Participant.code).where(Participant.withdrawn_at.is_not(None))).all() == ["P3"]
    for whose in ("people", "all"):
        with full.database.transaction() as s:
            taken = take_snapshot(s, full.files, study_id=full.id, whose=whose)
            original = load_snapshot(s, full.files, taken.id)
        with there.transaction() as s:
            taken = take_snapshot(s, their_files, study_id=full.id, whose=whose)
            imported = load_snapshot(s, their_files, taken.id)
        assert imported.answers == original.answers
        assert imported.left_out == {**original.left_out, "withdrawn": 0}  # they are not there to be left out


def test_importing_twice_is_refused(full: SmallStudy, exported: Path):
    with pytest.raises(DatasetError, match="is in this database already"):
        import_dataset(full.database, full.files, exported)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda d: (d / "responses.parquet").write_bytes(b"x"), "responses.parquet: was changed"),
        (lambda d: (d / "trials.csv").unlink(), "trials.csv: is missing"),
        (lambda d: (d / "extra.txt").write_text("x"), "extra.txt: is not listed"),
        (lambda d: (d / CHECKSUMS_FILE).unlink(), "is no exported data set"),
    ],
)
def test_a_data_set_that_was_touched_is_refused(copied: Path, tmp_path: Path, damage: object, message: str):
    damage(copied)
    fresh = Database(f"sqlite:///{tmp_path / 'there.sqlite'}")
    fresh.migrate()
    with pytest.raises(DatasetError, match=message):
        import_dataset(fresh, ArtefactStore((tmp_path / "there").as_uri()), copied)


def forge(folder: Path, name: str, content: bytes) -> None:
    """Change a file together with its checksum, as somebody who means it would."""
    (folder / name).write_bytes(content)
    lines = (folder / CHECKSUMS_FILE).read_text().splitlines()
    sha = hashlib.sha256(content).hexdigest()
    (folder / CHECKSUMS_FILE).write_text(
        "".join(f"{sha if line.endswith('  ' + name) else line[:64]}{line[64:]}\n" for line in lines)
    )


def test_a_forged_data_set_leaves_nothing_behind(exported: Path, copied: Path, tmp_path: Path):
    fresh, store = Database(f"sqlite:///{tmp_path / 'there.sqlite'}"), ArtefactStore((tmp_path / "there").as_uri())
    fresh.migrate()
    name = f"trajectories/{trajectory(3).digest()}.npz"
    pickled = tmp_path / "objects.npz"
    np.savez(pickled, poses=np.array([{"run": "me"}], dtype=object))
    original = (copied / name).read_bytes()
    for content in (pickled.read_bytes(), b"x", trajectory(999).to_bytes()):
        forge(copied, name, content)
        with pytest.raises(DatasetError, match="than its name says"):
            import_dataset(fresh, store, copied)
    forge(copied, name, original)
    forge(copied, "sessions.parquet", (copied / "participants.parquet").read_bytes())
    with pytest.raises(DatasetError, match=r"sessions.parquet: column 'session' \(text\) is missing"):
        import_dataset(fresh, store, copied)
    forge(copied, "sessions.parquet", (exported / "sessions.parquet").read_bytes())
    for name, content in {
        "protocol.yaml": PROTOCOL_YAML.replace("version: 1", "version: 2"),
        "frozen.json": json.dumps({"protocol": {}, "files": {**FILES, "texts/information.md": "# Another\n"}}),
    }.items():
        original = (copied / "protocol" / name).read_bytes()
        forge(copied, f"protocol/{name}", content.encode())
        with pytest.raises(DatasetError, match="this is not the protocol that the answers were collected with"):
            import_dataset(fresh, store, copied)
        forge(copied, f"protocol/{name}", original)
    bomb = "a: &a [x, x]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]\n" for n in range(1, 40)).replace("a0", "a")
    for name, content in {
        "protocol.yaml": bomb,
        "frozen.json": json.dumps({"protocol": {}, "files": {"questionnaires/background.yaml": bomb}}),
    }.items():
        original = (copied / "protocol" / name).read_bytes()
        forge(copied, f"protocol/{name}", content.encode())
        with pytest.raises(DatasetError, match="is too much"):
            import_dataset(fresh, store, copied)
        forge(copied, f"protocol/{name}", original)
    with fresh.session() as s:
        assert s.scalars(select(Study)).all() == []
        assert s.scalars(select(Participant)).all() == []


def test_a_folder_that_holds_something_is_not_written_into(full: SmallStudy, tmp_path: Path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.txt").write_text("three years of work")
    with pytest.raises(ExportError, match="is not an empty folder"):
        export_study(full.database, full.files, full.id, tmp_path / "out")
    with pytest.raises(LookupError, match="no study"):
        export_study(full.database, full.files, "unknown", tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_an_export_that_fails_leaves_no_half_data_set(study: SmallStudy, tmp_path: Path):
    study.participant("P1")
    study.files.delete(trajectory(3).digest())
    with pytest.raises(ArtefactError, match="is not in the artefact store"):
        export_study(study.database, study.files, study.id, tmp_path / "exports" / "out")
    assert list((tmp_path / "exports").iterdir()) == []


def test_a_study_without_answers_exports_empty_tables(study: SmallStudy, tmp_path: Path):
    said = export_study(study.database, study.files, study.id, tmp_path / "out")
    rows = {file["path"]: file["rows"] for file in said["files"]}
    assert rows["responses.csv"] == rows["trajectory_steps.parquet"] == 0
    assert csv_rows(tmp_path / "out", "responses") == []


def test_the_dictionary_in_the_docs_is_the_one_in_the_data_sets():
    text = (Path(__file__).resolve().parents[2] / "docs" / "data-dictionary.md").read_text()
    assert text == data_dictionary()
    assert all(f"`{column.name}`" in text for table in TABLES for column in table.columns)


def test_the_dictionary_names_everything_that_lies_in_a_data_set(exported: Path):
    text = (exported / "data-dictionary.md").read_text()
    tables = {f"{table.name}{ending}" for table in TABLES for ending in (".csv", ".parquet")}
    for path in exported.iterdir():
        assert path.name in tables or f"`{path.name}{'/' if path.is_dir() else '`'}" in text, path.name


def test_an_export_can_be_moved_and_read_elsewhere(copied: Path, tmp_path: Path):
    shutil.move(copied, tmp_path / "elsewhere")
    fresh = Database(f"sqlite:///{tmp_path / 'there.sqlite'}")
    fresh.migrate()
    said = import_dataset(fresh, ArtefactStore((tmp_path / "there").as_uri()), tmp_path / "elsewhere")
    assert said["responses"] == 14


def test_data_for_publication_hold_nothing_of_who_did_not_agree_but_one_row(study: SmallStudy, tmp_path: Path):
    agreed, _ = study.participant("P1", secret="sunshine")
    refused, _ = study.participant("P2", secret="thunderstorm", drives=100)
    study.participant("P3", secret="hurricane", drives=200)  # who left before the consent
    with study.database.transaction() as s:
        asked = {"consent": {"purposes": {"open_data": {"en": "May it be published?"}}}}
        row = s.get_one(Study, study.id)
        row.protocol = {**row.protocol, "stages": [asked]}
        s.get_one(Participant, agreed).consents = {"training": False, "open_data": True}
        s.get_one(Participant, refused).consents = {"training": True, "open_data": False}
    export_study(study.database, study.files, study.id, tmp_path / "open", open_data=True)
    export_study(study.database, study.files, study.id, tmp_path / "own")
    told = {
        row["participant"]: (row["training"], row["open_data"])
        for row in parquet_rows(tmp_path / "open", "participants")
    }
    assert told == {"P1": (False, True), "P2": (True, False), "P3": (None, None)}
    assert {row["participant"] for row in parquet_rows(tmp_path / "open", "responses")} == {"P1"}
    assert {row["participant"] for row in parquet_rows(tmp_path / "own", "responses")} == {"P1", "P2", "P3"}
    everything = b"".join(path.read_bytes() for path in (tmp_path / "open").rglob("*.csv"))
    assert b"sunshine" in everything
    assert b"thunderstorm" not in everything
    assert b"hurricane" not in everything


def test_pooled_snapshots_leave_out_who_did_not_let_us_learn(study: SmallStudy):
    agreed, _ = study.participant("P1")
    refused, _ = study.participant("P2", drives=100)
    with study.database.transaction() as s:
        s.get_one(Participant, agreed).consents = {"training": True}
        s.get_one(Participant, refused).consents = {"training": False}
        snapshot = load_snapshot(s, study.files, take_snapshot(s, study.files, study_id=study.id).id)
    assert {answer.participant for answer in snapshot.answers} == {"P1"}
    assert snapshot.left_out["no_consent"] == 5
