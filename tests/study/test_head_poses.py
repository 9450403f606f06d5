"""How heads move in headsets: what is kept of it, of whom, and what is not taken."""

from __future__ import annotations

import math
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from pydantic import ValidationError
from sqlalchemy import func, select

from desirepath.store.database import Database
from desirepath.store.dataset.importing import import_dataset
from desirepath.store.dataset.writing import export_study
from desirepath.store.erasure import erase_participant
from desirepath.store.models import HeadPose, Session, Trial
from desirepath.study.protocol.freezing import ProtocolError, freeze_text, validate_protocol_file
from desirepath.study.protocol.headset_words import HEAD, HEADSET
from desirepath.study.refusals import Refused
from desirepath.study.session import head_poses, machine
from desirepath.study.session.head_poses import Part, keep_part
from desirepath.web.participant.sent import HeadMoved
from tests.study.small_protocol import BLOCK, CONSENT, INFORMATION, protocol_text, write_files

INSIDE = {"block": {**BLOCK["block"], "view": "immersive"}}
DEVICE = {"headset": "offered", "head_pose": True, "webgl": False}
CONSENTING = {"consent": {**CONSENT["consent"], "text": "head.md"}}
WORN = "a1b2c3d4e5f60718"


@pytest.fixture
def worn(tmp_path, walk):
    """Somebody at the first pair of a study that stores how heads move, and says so."""
    (tmp_path / "head.md").write_text(f"# Consent\n{HEADSET['en']} {HEAD['en']}\n")
    return walk(INSIDE, device=DEVICE, consent_stage=CONSENTING)


def part(number: int = 0, n: int = 90, *, playback: str | None = None, wearing: str = WORN) -> Part:
    """Three seconds of somebody who looks around."""
    times = [round(k / 30, 4) for k in range(n)]
    poses = [[0.5, -1.0, 1.6, 0.0, 0.0, math.sin(t / 2), math.cos(t / 2)] for t in times]
    return Part(wearing, number, 3.0 * number, -2.0 if playback else None, playback, times, poses)


def stored(walker) -> list[HeadPose]:
    with walker.database.session() as s:
        return list(s.scalars(select(HeadPose).order_by(HeadPose.part)))


def refused(walker, sent: Part, key: str = "block.01") -> str:
    with pytest.raises(Refused) as no:
        walker.do(keep_part, key, sent)
    return no.value.code


def test_a_part_counts_once_and_says_what_played(worn):
    playing = worn.do(machine.start_trial, "block.01", request_id=None, now=worn.now)
    assert worn.do(keep_part, "block.01", part(1, playback=playing.playback_id))
    assert not worn.do(keep_part, "block.01", part(1, n=30)), "the first stays"
    assert worn.do(keep_part, "block.01", part(0)), "out of order"
    worn.do(machine.interrupt, reason="page_loaded", now=worn.now)
    worn.do(keep_part, "block.01", part(2, playback=playing.playback_id))  # of before the restart, and late
    with worn.database.session() as s:
        trial = s.scalars(select(Trial)).one()
    assert [(one.trial_id, one.side, one.showing, one.playing_s) for one in stored(worn)] == [
        (None, None, None, None),
        (trial.id, "a", 0, -2.0),
        (trial.id, "a", 0, -2.0),
    ]


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"times_s": [0.0]}, "bad_value"),
        ({"times_s": [0.1, 0.2], "poses": [[0, 0, 0, 0, 0, 0, 1]] * 2}, "bad_value"),
        ({"times_s": [0.0, -0.1], "poses": [[0, 0, 0, 0, 0, 0, 1]] * 2}, "bad_value"),
        ({"times_s": [0.0, 31.0], "poses": [[0, 0, 0, 0, 0, 0, 1]] * 2}, "bad_value"),
        ({"times_s": [k / 1000 for k in range(90)]}, "bad_value"),
        ({"times_s": [0.0], "poses": [[0, 0, math.nan, 0, 0, 0, 1]]}, "bad_value"),
        ({"times_s": [0.0], "poses": [[0, 0, 0, 0, 0, 0, 0]]}, "bad_value"),
        ({"times_s": [0.0], "poses": [[0, 0, 0, 1]]}, "bad_value"),
        ({"playback": "of another trial"}, "bad_value"),
    ],
)
def test_what_no_head_can_have_done_is_refused(worn, change, code):
    assert refused(worn, Part(**{**part().__dict__, **change})) == code
    assert not stored(worn)


@pytest.mark.parametrize(
    "change",
    [
        {"times_s": [0.0] * 401},
        {"poses": [[0, 0, 0, 0, 0, 0, 1]] * 401},
        {"poses": [[0, 0, math.inf, 0, 0, 0, 1]]},
        {"poses": [[0, 0, None, 0, 0, 0, 1]]},
        {"poses": [[0, 0, 1e9, 0, 0, 0, 1]]},
        {"poses": [[0] * 70_000]},
        {"poses": "many"},
        {"times_s": []},
        {"part": -1},
        {"part": 10**12},
        {"wearing": "../../etc"},
        {"began_s": -1},
        {"began_s": math.nan},
        {"playing_s": 1e9},
        {"playback_id": "x" * 65},
    ],
)
def test_what_a_page_sends_is_bounded_before_anything_looks_into_it(change):
    sent = {"wearing": WORN, "part": 0, "began_s": 0, "times_s": [0.0], "poses": [[0, 0, 1.6, 0, 0, 0, 1]]}
    HeadMoved.model_validate(sent)
    with pytest.raises(ValidationError) as wrong:
        HeadMoved.model_validate(sent | change)
    assert wrong.value.error_count() == 1


def test_nothing_is_kept_that_was_not_asked_for_or_agreed_to(tmp_path, walk, worn, monkeypatch):
    assert refused(worn, part(), "debriefing") == "no_such_room", "nobody was there yet"
    assert refused(worn, part(), "block.02") == "no_such_room"
    assert refused(worn, part(), "consent") == "no_such_room"
    assert refused(walk(INSIDE, device={"headset": "offered", "webgl": False}), part()) == "not_asked"
    monkeypatch.setattr(head_poses, "MOST_SAMPLES", 100)
    worn.do(keep_part, "block.01", part(0))
    assert refused(worn, part(1)) == "enough"
    monkeypatch.undo()
    other = walk(INSIDE, device=DEVICE, consent_stage=CONSENTING)
    of_the_other = other.do(machine.start_trial, "block.01", request_id=None, now=other.now).playback_id
    assert refused(worn, part(1, playback=of_the_other)) == "bad_value", "another person's trial"
    worn.do(machine.withdraw, now=worn.now)
    assert refused(worn, part(2)) == "not_running"


def test_a_study_that_does_not_tell_stores_nothing(tmp_path):
    write_files(tmp_path)
    with pytest.raises(ProtocolError) as wrong:
        freeze_text(protocol_text([INFORMATION, INSIDE], device=DEVICE), folder=tmp_path)
    assert HEAD["en"] in str(wrong.value)
    with pytest.raises(ProtocolError) as wrong:
        freeze_text(protocol_text([INSIDE], device={"head_pose": True}), folder=tmp_path)
    assert "needs headset" in str(wrong.value)
    file = tmp_path / "small.yaml"
    file.write_text(protocol_text([INFORMATION, INSIDE], device={"headset": "offered"}))
    checked = validate_protocol_file(file)
    assert checked["valid"]
    assert HEADSET["en"] in checked["warnings"][0]["message"]
    (tmp_path / "information.md").write_text(f"# Information\n{HEADSET['en']}\n")
    assert validate_protocol_file(file) == {"valid": True, "errors": []}


def test_it_is_exported_brought_back_and_erased(worn, files, tmp_path: Path):
    playing = worn.do(machine.start_trial, "block.01", request_id=None, now=worn.now)
    sent = part(0, playback=playing.playback_id)
    worn.do(keep_part, "block.01", sent)
    worn.do(keep_part, "block.01", part(1))
    with worn.database.session() as s:
        session = s.get_one(Session, worn.session.id)
        study, person = session.study_id, session.participant_id
    first, again = tmp_path / "first", tmp_path / "again"
    export_study(worn.database, files, study, first)
    rows = pq.read_table(first / "head_poses.parquet").to_pylist()
    assert [(row["side"], row["part"], row["step"]) for row in rows] == [("a", 0, "block.01"), (None, 1, "block.01")]
    assert rows[0]["z_m"] == pytest.approx([1.6] * 90)
    assert rows[0]["qz"] == pytest.approx([pose[5] for pose in sent.poses])
    assert not (first / "head_poses.csv").exists()

    other = Database(f"sqlite:///{tmp_path / 'other.sqlite'}")
    other.migrate()
    import_dataset(other, files, first)
    export_study(other, files, study, again)
    assert pq.read_table(again / "head_poses.parquet").drop("created_at") == pq.read_table(
        first / "head_poses.parquet"
    ).drop("created_at")
    other.close()

    done = erase_participant(worn.database, files, person, "tester", data=tmp_path, compact=False)
    assert done["counts"]["head_poses"] == 2
    with worn.database.session() as s:
        assert s.scalar(select(func.count()).select_from(HeadPose)) == 0
    assert refused(worn, part(2)) == "unknown", "whoever was erased has no session"
