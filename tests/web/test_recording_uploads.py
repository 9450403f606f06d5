"""I upload what my robot did, say which column or topic is what, look at it, and have pairs that a study can show."""

from __future__ import annotations

import asyncio
import hashlib
import io
import json
import re
import shutil
import time
import zipfile
from pathlib import Path

import pytest
from sqlalchemy import select
from typer.testing import CliRunner

from desirepath import zip_files
from desirepath.cli.main import app
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.models import Artefact, Audit
from desirepath.store.snapshots import Snapshot
from desirepath.web import server
from desirepath.web.analyst import recording_drafts
from desirepath.web.analyst.recording_drafts import find_recording_draft
from desirepath.web.core import draft_folders
from desirepath.web.core.throttle import LARGEST_BODY
from tests.recordings.films import mp4, webm
from tests.recordings.test_bags import messages, write_mcap
from tests.recordings.test_episodes import lerobot
from tests.recordings.walks import RUNS, csv_of, rows
from tests.web.lab_services import csrf

HALL = csv_of("run,who,time_s,x_m,y_m,yaw_rad", list(rows())).encode()
OWN_NAMES = csv_of(
    "Fahrt,Wer,Zeit [ms],Rechts,Hoch", [(run, who, t * 1000, x * 100, y * 100) for run, who, t, x, y, _ in rows()]
).encode()

processes = pytest.mark.usefixtures("in_processes")


@pytest.fixture
def in_processes() -> None:
    """Readings of this test have processes of their own, as everywhere else in the product."""


@pytest.fixture(autouse=True)
def readings(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Readings run in this process, without the second and a half that each would need to import the library."""
    if "in_processes" in request.fixturenames:
        return

    def answer_to(settings, draft, result: str, command: list[str]) -> bytes:
        return CliRunner().invoke(app, command).stdout_bytes

    monkeypatch.setattr(recording_drafts, "_answer_to", answer_to)


def send(lab, name: str, content: bytes, draft: str = "", answers: bool = False, **headers: str):
    asked = {"name": name, "draft": draft, "answers": str(answers).lower()}
    sent = {"X-CSRF": csrf(lab), "Content-Type": "application/octet-stream", **headers}
    return lab.post("/api/lab/recordings/files", params=asked, content=content, headers=sent)


def taken(lab, *files: tuple[str, bytes], answers: bytes = b"") -> str:
    """Address of an upload of these files."""
    draft = ""
    for name, content in files:
        reply = send(lab, name, content, draft)
        assert reply.status_code == 200, reply.text
        draft = reply.json()["draft"]
    if answers:
        assert send(lab, "mine.csv", answers, draft, answers=True).status_code == 200
    return f"/lab/recordings/{draft}"


def read(lab, address: str) -> str:
    """The page once the files were read."""
    lab.get(address)
    until = time.monotonic() + 120
    while lab.get(f"/api{address}").json()["working"]:
        assert time.monotonic() < until
        time.sleep(0.02)
    return lab.get(address).text


def make(lab, address: str, **form: str) -> str:
    sent = lab.post(address, data={"csrf": csrf(lab), "setup": "study_room"} | form, follow_redirects=False)
    assert sent.status_code == 303, sent.text
    return read(lab, address)


def keep(lab, address: str, name: str = "Mine", study: str = "") -> str:
    form = {"csrf": csrf(lab), "name": name, "study": study}
    kept = lab.post(f"{address}/keep", data=form, follow_redirects=False)
    assert kept.status_code == 303, kept.text
    return kept.headers["location"]


def chosen(page: str, name: str) -> str:
    """What a select of the page has chosen."""
    select_ = re.search(rf'<select id="{re.escape(name)}".*?</select>', page, re.S).group()
    found = re.search(r'<option(?: value="([^"]*)")? selected>([^<]*)', select_)
    return (found[1] or found[2]) if found else ""


@processes
def test_a_table_with_usual_names_is_uploaded_looked_at_and_kept(lab, lab_services):
    address = taken(lab, ("hall.csv", HALL))
    page = read(lab, address)
    assert {n: chosen(page, f"column.{n}") for n in ("time", "x", "who")} == {
        "time": "time_s",
        "x": "x_m",
        "who": "who",
    }
    page = make(lab, address)
    assert "Runs: 3, places: 1, pairs: 3" in page
    assert "Fahrten: 3, Orte: 1, Paare: 3" in lab.get(address, headers={"Accept-Language": "de"}).text
    assert "<svg" in page
    assert '<iframe class="replay"' in lab.get(f"{address}?stage=1&pair=1").text
    kept = keep(lab, address)
    assert lab.get(address).status_code == 404
    listed = lab.get("/lab/recordings").text
    assert "hall.csv" in listed
    assert kept in listed
    assert f"query_set: {kept.rsplit('/', 1)[1]}" in lab.get(kept).text
    with lab_services.database.session() as s:
        card = s.scalars(select(Artefact).where(Artefact.name == "Mine")).one().card
        assert [one["file"] for one in card["imported"]["files"]] == ["hall.csv"]
        one = Trajectory.from_bytes(lab_services.files.get(card["stored_queries"][0]["trajectory_a"]))
        assert one.recorded.has == ("poses", "heading", "people")


def test_columns_of_other_names_are_chosen_with_their_units(lab):
    address = taken(lab, ("mine.csv", OWN_NAMES))
    page = read(lab, address)
    assert chosen(page, "column.x") == ""
    refused = make(lab, address)
    assert "no column for time" in refused
    columns = {"time": "Zeit [ms]", "x": "Rechts", "y": "Hoch", "who": "Wer", "run": "Fahrt"}
    form = {f"column.{ours}": head for ours, head in columns.items()}
    assert "names no unit" in make(lab, address, **form)
    page = make(lab, address, **form, **{"unit.length": "cm"})
    assert "Runs: 3, places: 1, pairs: 3" in page
    assert chosen(page, "column.x") == "Rechts"  # what was chosen is still there
    assert chosen(page, "unit.length") == "cm"


@processes
def test_topics_of_bags_are_shown_with_types_and_counts_and_can_be_chosen(lab, tmp_path):
    files = []
    for name, aside in RUNS.items():
        said = [(t.replace("/odom", "/base/odom"), *rest) for t, *rest in messages(aside)]
        files.append((f"{name}.mcap", write_mcap(tmp_path / "bags" / f"{name}.mcap", said).read_bytes()))
    address = taken(lab, *files)
    page = read(lab, address)
    assert "nav_msgs/msg/Odometry, 81" in page
    assert chosen(page, "topic.pose") == "/base/odom"
    assert chosen(page, "topic.people") == "/people"
    page = make(lab, address, **{"topic.pose": "/base/odom", "topic.people": "/people"})
    assert "Runs: 3, places: 1, pairs: 3" in page


def test_a_zip_of_a_data_set_is_unpacked_and_its_fields_are_chosen(lab, tmp_path):
    folder, packed = lerobot(tmp_path / "mine"), io.BytesIO()
    with zipfile.ZipFile(packed, "w") as out:
        for file in folder.rglob("*.*"):
            out.write(file, f"mine/{file.relative_to(folder)}")
    address = taken(lab, ("mine.zip", packed.getvalue()))
    page = read(lab, address)
    assert chosen(page, "robot.field") == "observation.state"
    form = {"robot.field": "observation.state", "robot.x": "0", "robot.y": "1", "robot.yaw": "2"}
    more = "people: {anna: {field: observation.people, x: 0, y: 1}}"
    page = make(lab, address, **form, more=more)
    assert "Runs: 3, places: 1, pairs: 3" in page
    assert "recorded: poses, heading, people" in re.sub(r"\s+", " ", page)


def test_pairs_that_are_given_are_taken(lab):
    address = taken(lab, ("hall.csv", HALL), ("pairs.csv", b"a,b\nwide,straight\n"))
    read(lab, address)
    page = make(lab, address, pairs="given")
    assert "Pair 1 of 1" in page
    assert "A: wide" in page


def test_answers_given_elsewhere_become_a_snapshot_marked_as_imported(lab, lab_services):
    answers = b"a,b,choice,person\nwide,straight,a,p1\nstraight,other_side,other_side,p2\nwide,straight,b,p2\n"
    address = taken(lab, ("hall.csv", HALL), answers=answers)
    read(lab, address)
    assert "3 answers" in make(lab, address)
    kept = keep(lab, address, "Elsewhere")
    assert kept.startswith("/lab/snapshots/")
    assert "people, imported from a file" in lab.get(kept).text
    snapshot = Snapshot.from_bytes(lab_services.files.get(kept.rsplit("/", 1)[1]))
    assert [(one.participant, one.choice) for one in snapshot.answers] == [("p1", "a"), ("p2", "b"), ("p2", "b")]
    assert "3 answers of 2 people" in lab.get("/lab/recordings").text


def test_videos_are_uploaded_with_their_pairs_watched_and_kept(lab, lab_services):
    films = ("one.mp4", mp4(2.0)), ("two.webm", webm(3.0)), ("pairs.csv", b"a,b\none.mp4,two.webm\n")
    address = taken(lab, *films)
    read(lab, address)
    page = make(lab, address)
    assert "Only videos were recorded" in page
    assert f'src="{address}/videos/one.mp4"' in page
    part = lab.get(f"{address}/videos/one.mp4", headers={"Range": "bytes=4-7"})
    assert (part.status_code, part.content, part.headers["content-type"]) == (206, b"ftyp", "video/mp4")
    assert lab.get(f"{address}/videos/pairs.csv").status_code == 404
    kept = keep(lab, address, "Films")
    assert "one.mp4" in lab.get(kept).text  # what it was made of
    with lab_services.database.session() as s:
        assert sorted(s.scalars(select(Artefact.name).where(Artefact.kind == "video"))) == ["one.mp4", "two.webm"]


def test_two_videos_of_one_file_name_are_told_apart(lab, lab_services):
    films = {"mon/cam.webm": webm(3.0, mark=b"1"), "tue/cam.webm": webm(3.0, mark=b"2")}
    address = taken(lab, ("films.zip", zipped(**films)), ("pairs.csv", b"a,b\nmon/cam.webm,tue/cam.webm\n"))
    read(lab, address)
    page = make(lab, address)
    assert "Pair 1 of 1" in page
    for name, content in films.items():
        assert f'src="{address}/videos/{name}"' in page
        assert lab.get(f"{address}/videos/{name}").content == content
    assert lab.get(f"{address}/videos/cam.webm").status_code == 404


def test_files_of_one_place_become_pairs_as_the_page_says(lab):
    lines = HALL.decode().splitlines()
    runs = [(f"{run}.csv", "\n".join([lines[0], *(one for one in lines if one.startswith(f"{run},"))]).encode())
            for run in ("wide", "straight")]  # fmt: skip
    address = taken(lab, *runs)
    assert "`scene: lab`" in read(lab, address)
    refused = make(lab, address)
    assert "2 runs in 2 scenes; `scene: lab` in the mapping" in refused
    assert "Runs: 2, places: 1, pairs: 1" in make(lab, address, more="scene: lab")


def test_nothing_changes_while_files_are_read_and_the_card_says_what_was_read(lab, lab_services):
    address = taken(lab, ("hall.csv", HALL))
    read(lab, address)
    make(lab, address, more="origin: [1, 0]")
    draft = find_recording_draft(lab_services.settings.data, address.rsplit("/", 1)[1])
    with draft.claimed():
        changed = lab.post(address, data={"csrf": csrf(lab), "setup": "open_field", "more": "origin: [2, 0]"})
        assert (changed.status_code, "files are being read" in changed.text) == (409, True)
        assert send(lab, "mine.csv", b"a,b,choice\nwide,straight,a\n", draft.id, answers=True).status_code == 409
        assert send(lab, "more.csv", HALL, draft.id).status_code == 409
        assert lab.post(f"{address}/keep", data={"csrf": csrf(lab), "name": "x"}).status_code == 409
    assert [name for name, _ in draft.files()] == ["hall.csv"]
    assert draft.read("asked")["setup"] == "study_room"
    draft.map("origin: [3, 0]")
    keep(lab, address)
    with lab_services.database.session() as s:
        card = s.scalars(select(Artefact).where(Artefact.name == "Mine")).one().card["imported"]
    assert card["mapping"] == "origin:\n- 1.0\n- 0.0\n"
    assert card["files"][-1]["sha256"] == hashlib.sha256(card["mapping"].encode()).hexdigest()


@processes
def test_a_reading_may_take_so_much_memory(lab, monkeypatch):
    monkeypatch.setattr(recording_drafts, "MEMORY_BYTES", 64 * 2**20)
    page = read(lab, taken(lab, ("hall.csv", HALL)))
    assert "of memory: import parts" in page


def test_a_place_of_many_digits_is_a_wrong_place(lab):
    address = taken(lab, ("hall.csv", HALL))
    sent = lab.post(address, data={"csrf": csrf(lab), "setup": "?", "robot.field": "state", "robot.x": "9" * 5_000})
    assert sent.status_code == 422


def test_a_video_that_was_renamed_or_cut_is_refused_with_a_sentence(lab):
    address = taken(lab, ("one.mp4", webm()), ("two.mp4", mp4()[:-9]), ("pairs.csv", b"a,b\none.mp4,two.mp4\n"))
    read(lab, address)
    assert "is no MP4, which begins with" in make(lab, address)


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("cut.mcap", b"\x89MCAP0\r\n" + b"\0" * 40, "is cut or no MCAP"),
        ("nan.csv", b"time_s,x_m,y_m\n0,0,0\n1,nan,0\n", "line 3, column x_m"),
        ("back.csv", b"time_s,x_m,y_m\n0,0,0\n1,1,0\n0.5,1,0\n", "goes back from 1 s; sort by time"),
        ("notes.txt", b"nothing", "no recording in it"),
    ],
)
def test_what_cannot_be_read_says_why_on_the_page_as_on_the_command_line(lab, name, content, why):
    address = taken(lab, (name, content))
    page = read(lab, address)
    if "cannot be read" not in page:
        page = make(lab, address)
        assert "No pairs could be made" in page
    assert why in page
    assert lab.post(f"{address}/keep", data={"csrf": csrf(lab), "name": "x"}).status_code == 422


def test_frames_and_topics_that_do_not_fit_are_named(lab, tmp_path):
    file = write_mcap(tmp_path / "bags" / "one.mcap", messages(0.0, people_frame="map"))
    address = taken(lab, ("one.mcap", file.read_bytes()))
    read(lab, address)
    page = make(lab, address, **{"topic.pose": "/odom", "topic.people": "/people"})
    assert "must be &#39;odom&#39;" in page
    page = make(lab, address, **{"topic.pose": "/gone"})
    assert "topic /gone: is not in the bag" in page


def test_uploads_are_bounded_before_they_are_read(lab, lab_services, monkeypatch):
    monkeypatch.setattr(recording_drafts, "MOST_BYTES", 3 * LARGEST_BODY)
    whole = send(lab, "large.csv", b"x" * (LARGEST_BODY + 1))
    assert whole.status_code == 200  # more than any other body
    draft = whole.json()["draft"]
    assert "More than 6 MB" in send(lab, "more.csv", b"x" * (2 * LARGEST_BODY), draft).json()["error"]["message"]
    assert [name for name, _ in recording_drafts.recording_drafts(lab_services.settings.data)[0].files()] == [
        "large.csv"
    ]
    as_json = send(lab, "x.csv", b"x" * (LARGEST_BODY + 1), **{"Content-Type": "application/json"})
    assert as_json.status_code == 413
    for name in ("../x.csv", ".x", "a/b.csv", "x" * 200):
        assert send(lab, name, b"x").status_code == 422
    assert send(lab, "large.csv", b"x", draft).status_code == 422
    assert send(lab, "empty.csv", b"").status_code == 422
    assert send(lab, "x.csv", b"x", "0" * 16).status_code == 404


def zipped(**files: bytes) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as out:
        for name, content in files.items():
            out.writestr(name, content)
    return packed.getvalue()


def test_zips_that_reach_out_or_unpack_to_too_much_are_refused(lab, lab_services, monkeypatch):
    monkeypatch.setattr(recording_drafts, "MOST_BYTES", 1_000_000)
    link = zipfile.ZipInfo("link.csv")
    link.external_attr = 0o120777 << 16
    linked = io.BytesIO()
    with zipfile.ZipFile(linked, "w") as out:
        out.writestr(link, "/etc/passwd")
    lies = bytearray(zipped(**{"a.csv": b"x" * 5_000}))
    for at in (lies.find(b"PK\x01\x02") + 24, lies.find(b"PK\x03\x04") + 22):
        lies[at : at + 4] = (10).to_bytes(4, "little")
    for content in (
        zipped(**{"../out.csv": b"x"}),
        zipped(**{"/abs.csv": b"x"}),
        zipped(**{"bomb.csv": b"0" * 2_000_000}),
        linked.getvalue(),
        bytes(lies),
        zipped(**{"a.csv": b"x" * 900})[:-30],
    ):
        refused = send(lab, "some.zip", content)
        if refused.status_code == 200:  # no zip any more, and taken as the file it is
            assert "no recording in it" in read(lab, refused.json()["href"])
        else:
            assert refused.status_code == 422
            assert not list(lab_services.settings.data.glob("recordings/*/recordings/*.csv"))
    assert not list(lab_services.settings.data.rglob("out.csv"))
    assert not list(Path("/").glob("abs.csv"))
    damaged = bytearray(zipped(**{"a.csv": HALL}))
    damaged[60:80] = bytes(20)
    assert send(lab, "some.zip", bytes(damaged)).status_code == 422
    monkeypatch.setattr(zip_files, "MOST_DIRECTORY_BYTES", 1_000)
    refused = send(lab, "some.zip", zipped(**{f"{k}.csv": b"x" for k in range(100)}))
    assert (refused.status_code, "list of files is longer" in refused.text) == (422, True)


def test_of_a_refused_zip_nothing_is_left(lab, lab_services):
    draft_id = send(lab, "hall.csv", HALL).json()["draft"]
    draft = find_recording_draft(lab_services.settings.data, draft_id)
    twice = io.BytesIO()
    with zipfile.ZipFile(twice, "w") as out:
        out.writestr("q.csv", "1")
        with pytest.warns(UserWarning, match="Duplicate"):
            out.writestr("q.csv", "2")
    broken = bytearray(zipped(**{"ok.csv": b"hello", "bad.csv": HALL}))
    broken[broken.find(b"bad.csv") + 30] ^= 0xFF
    for content, why in (
        (zipped(**{"b.csv": HALL, "hall.csv": b"x"}), "hall.csv was uploaded already"),
        (zipped(**{"b.csv": HALL, "hall.csv/x.csv": b"x"}), "was uploaded already"),
        (zipped(**{"w.csv": b"1", "w.csv/x.csv": b"2"}), "was uploaded already"),
        (twice.getvalue(), "q.csv was uploaded already"),
        (zipped(**{"ok.csv": HALL, "\u6f22" * 110 + ".csv": HALL}), "is no name for a file"),
        (bytes(broken), "cannot be unpacked"),
    ):
        refused = send(lab, "some.zip", content, draft_id)
        assert (refused.status_code, why in refused.json()["error"]["message"]) == (422, True), refused.text
        assert [one.name for one in draft.recordings.rglob("*")] == ["hall.csv"]
        assert not list(draft.folder.glob(".*"))
    assert send(lab, "\u6f22" * 110 + ".csv", HALL).status_code == 422


def test_an_analyst_of_one_study_sees_own_uploads_only(lab, lab_services, colleague):
    address = taken(lab, ("hall.csv", HALL))
    member = colleague("member", "analyst")
    own = taken(member, ("own.csv", HALL))
    listed = member.get("/lab/recordings").text
    assert (own in listed, address in listed) == (True, False)
    assert member.get(own).status_code == 200
    assert [member.get(path).status_code for path in (address, f"/api{address}")] == [404, 404]
    assert member.post(f"{address}/discard", data={"csrf": csrf(member)}).status_code == 404
    assert send(member, "more.csv", HALL, address.rsplit("/", 1)[1]).status_code == 404
    assert own in lab.get("/lab/recordings").text  # who may analyse everywhere sees all
    assert lab.post(f"{own}/discard", data={"csrf": csrf(lab)}, follow_redirects=False).status_code == 303
    with lab_services.database.session() as s:
        (entry,) = s.scalars(select(Audit).where(Audit.action == "recordings_discarded"))
        assert entry.data["sent_by"] == "a-member-analyst"


def test_what_is_kept_belongs_to_a_study_that_one_may_see(lab, lab_services, two_studies, colleague):
    address = taken(lab, ("hall.csv", HALL))
    read(lab, address)
    page = make(lab, address)
    assert f'<option value="{two_studies.theirs}"' in page
    assert '<option value="" selected>no study' in page
    again = shutil.copytree(  # somebody else's upload of the same
        find_recording_draft(lab_services.settings.data, address.rsplit("/", 1)[1]).folder,
        lab_services.settings.data / "recordings" / ("a" * 16),
    )
    kept = keep(lab, address, study=two_studies.theirs)

    member = colleague("member", "analyst")
    assert member.get(kept).status_code == 403
    assert kept not in member.get("/lab/recordings").text
    sent = json.loads((again / "sent.json").read_bytes())
    (again / "sent.json").write_text(json.dumps(sent | {"by": "a-member-analyst"}))
    refused = member.post(f"/lab/recordings/{again.name}/keep", data={"csrf": csrf(member), "name": "Mine"})
    assert (refused.status_code, "These recordings are here already" in refused.text) == (409, True)

    own = taken(member, ("own.csv", HALL), answers=b"a,b,choice\nwide,straight,a\nstraight,wide,b\n")
    read(member, own)
    page = make(member, own)
    assert "It will belong to the study “Corridor pilot”" in page
    kept = keep(member, own, study=two_studies.theirs)  # not theirs to give
    assert kept in member.get("/lab/recordings").text
    with lab_services.database.session() as s:
        made = s.scalars(select(Artefact).where(Artefact.card["imported"].is_not(None), Artefact.name.like("Mine%")))
        assert sorted((one.kind, one.study_id) for one in made if one.card["imported"]) == sorted(
            [("query_set", two_studies.theirs), ("query_set", two_studies.ours), ("snapshot", two_studies.ours)]
        )


def test_who_may_start_no_jobs_uploads_nothing_and_sees_no_uploads(lab, colleague):
    address = taken(lab, ("hall.csv", HALL))
    viewer = colleague("viewer")
    assert send(viewer, "x.csv", b"x").status_code == 403
    assert viewer.get(address).status_code == 403
    assert address not in viewer.get("/lab/recordings").text
    assert address in lab.get("/lab/recordings").text
    assert lab.post(f"{address}/discard", data={"csrf": csrf(lab)}, follow_redirects=False).status_code == 303
    assert lab.get(address).status_code == 404


def test_an_upload_that_nobody_kept_goes(lab, lab_services, monkeypatch):
    address = taken(lab, ("hall.csv", HALL))
    data, draft = lab_services.settings.data, address.rsplit("/", 1)[1]
    draft_folders.forget_drafts(data)
    assert find_recording_draft(data, draft) is not None
    monkeypatch.setattr(draft_folders, "LASTS_S", -1.0)

    async def until_gone() -> None:
        stopping = asyncio.Event()
        keeping = asyncio.create_task(server._keep_forgetting(lab_services.settings, stopping))
        while find_recording_draft(data, draft) is not None:  # whoever opens its page lets it be read
            await asyncio.sleep(0.05)
        stopping.set()
        await keeping

    asyncio.run(asyncio.wait_for(until_gone(), 30))
    assert lab.get(address).status_code == 404


def test_the_command_says_what_is_in_a_file(tmp_path):
    (tmp_path / "hall.csv").write_bytes(HALL)
    said = CliRunner().invoke(app, ["queries", "inspect", str(tmp_path / "hall.csv"), "--json"])
    found = json.loads(said.stdout.splitlines()[-1])
    assert found["format"] == "csv"
    assert {one["head"]: (one["ours"], one["unit"]) for one in found["columns"]}["yaw_rad"] == ("yaw", "rad")
