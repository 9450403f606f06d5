"""Somebody says aloud what they thought: with a consent of its own, in parts, kept and gone like every answer."""

from __future__ import annotations

from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.backup import backup
from desirepath.store.database import Database
from desirepath.store.dataset.importing import import_dataset
from desirepath.store.dataset.writing import export_study
from desirepath.store.erasure import erase_participant
from desirepath.store.models import Participant, Response
from desirepath.store.robot_recordings import recordings_of
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.studies import create_study
from desirepath.study.voices import LARGEST_PART
from desirepath.web.core.auth import add_user
from tests.study.small_protocol import BLOCK, protocol_text, write_files
from tests.web.participant_services import submit

HEAD = b"\x1a\x45\xdf\xa3" + b"\x00" * 20 + b"webm" + b"\x00" * 40 + b"A_OPUS" + b"\x00" * 200
WEBM = {"Content-Type": "audio/webm"}


@pytest.fixture
def speaking(services, client: TestClient, tmp_path: Path) -> tuple[str, str]:
    """A study and the link of somebody who has come to speak."""
    folder = tmp_path / "protocol"
    folder.mkdir()
    write_files(folder)
    text = protocol_text([{"think_aloud": {"text": "consent.md", "minutes": 1}}, BLOCK])
    with services.database.transaction() as s:
        study = create_study(s, services.files, freeze_text(text, folder=folder), name="Aloud", created_by=None)
        study.pilot = False
        identity, link = study.id, study.recruiting_token
    joined = client.post(f"/join/{link}", data={"language": "en", "device": '{"width": 1024, "webgl": true}'})
    token = joined.headers["location"].removeprefix("/p/")
    page = client.get(f"/p/{token}")
    assert "microphone=(self)" in page.headers["Permissions-Policy"]
    assert "microphone=()" in client.get("/lab/sign-in").headers["Permissions-Policy"]
    for _ in range(5):
        step = client.get(f"/api/session/{token}").json()["step"]
        if step["kind"] == "think_aloud":
            break
        submit(client, token, step["key"], {"given": True, "version": "1"} if step["kind"] == "consent" else {})
    return identity, token


def send(client: TestClient, token: str, part: int, content: bytes, headers=WEBM):
    return client.post(f"/api/session/{token}/voice/think_aloud?part={part}", content=content, headers=headers)


def answered(services, study: str) -> dict:
    with services.database.session() as s:
        return s.scalars(select(Response).where(Response.kind == "think_aloud")).one().value


def test_a_voice_comes_in_parts_is_heard_exported_and_erased(services, client, speaking, tmp_path):
    study, token = speaking
    assert send(client, token, 0, HEAD + b"one").status_code == 204
    assert send(client, token, 1, b"two").status_code == 204
    assert send(client, token, 1, b"two").status_code == 204, "a repeated part counts once"
    assert submit(client, token, "think_aloud", {"agreed": True}).status_code == 200
    value = answered(services, study)
    assert (value["agreed"], value["bytes"], value["problem"]) == (True, len(HEAD) + 6, "")
    assert services.files.get(value["recording"]) == HEAD + b"onetwo"
    with services.database.session() as s:
        assert recordings_of(s) == {value["recording"]}
        response = s.scalars(select(Response.id).where(Response.kind == "think_aloud")).one()
        person = s.scalars(select(Participant).where(Participant.study_id == study)).one()
    assert len([name for name in services.files.names() if services.files.get(name).startswith(HEAD[:4])]) == 1

    heard = f"/lab/studies/{study}/voices/{response}.webm"
    assert client.get(heard).status_code == 303
    password = add_user(services.database, "ear", "owner")
    signed = client.post("/lab/sign-in", data={"name": "ear", "password": password})
    assert signed.status_code == 303

    export_study(services.database, services.files, study, tmp_path / "out")
    voice = tmp_path / "out" / "recordings" / f"{value['recording']}.webm"
    assert voice.read_bytes() == HEAD + b"onetwo"
    export_study(services.database, services.files, study, tmp_path / "open", open_data=True)
    assert not (tmp_path / "open" / "recordings").exists()
    for name, there in (("out", True), ("open", False)):
        database = Database(f"sqlite:///{tmp_path / name}.sqlite")
        database.migrate()
        files = ArtefactStore((tmp_path / f"{name}-artefacts").as_uri())
        import_dataset(database, files, tmp_path / name)
        assert files.exists(value["recording"]) is there
        database.close()
    if services.database.file is not None:
        written = backup(services.database, services.files, tmp_path / "whole.tar")
        assert written["missing"] == []
    erased = erase_participant(services.database, services.files, person.id, by="test", data=tmp_path / "data")
    assert erased["counts"]["recordings"] == 1
    assert not services.files.exists(value["recording"])


def test_who_refuses_goes_on_and_nothing_stays_of_what_was_said(services, client, speaking):
    study, token = speaking
    assert send(client, token, 0, HEAD + b"one").status_code == 204
    with services.database.session() as s:
        (sha,) = recordings_of(s)
    assert submit(client, token, "think_aloud", {"agreed": False}).status_code == 200
    assert answered(services, study) == {
        "agreed": False,
        "problem": "",
        "recording": None,
        "bytes": 0,
        "seconds": 0.0,
    }
    assert not services.files.exists(sha)
    with services.database.session() as s:
        assert recordings_of(s) == set()
    assert send(client, token, 0, HEAD).status_code == 409, "the step is over"


def test_what_is_no_voice_too_much_or_out_of_order_is_refused(services, client, speaking, monkeypatch):
    _, token = speaking
    for content in (b"", b"RIFF....WAVE", b"<script>" * 50, HEAD.replace(b"webm", b"matr"), HEAD + b"V_VP8"):
        assert send(client, token, 0, content).status_code == 422, content[:20]
    assert send(client, token, 0, HEAD, {"Content-Type": "text/html"}).status_code == 415
    assert send(client, token, 1, b"late").status_code == 409
    assert send(client, token, 0, HEAD + b"x" * LARGEST_PART).status_code == 422
    assert send(client, token, 0, HEAD + b"x" * 300_000).status_code == 413
    assert send(client, token, -1, HEAD).status_code == 422
    for where, key in ((token, "..%2Fblock"), (token, "block"), ("x" * 43, "think_aloud")):
        told = client.post(f"/api/session/{where}/voice/{key}?part=0", content=HEAD, headers=WEBM)
        assert told.status_code in (404, 409), told.text
    assert send(client, token, 0, HEAD).status_code == 204
    assert send(client, token, 2, b"gap").status_code == 409
    monkeypatch.setattr("desirepath.study.voices.BYTES_PER_MINUTE", len(HEAD) + 2)
    assert send(client, token, 1, b"ab").status_code == 204
    assert send(client, token, 2, b"c").status_code == 413
    monkeypatch.setattr("desirepath.study.voices.LATE_S", -60.0)
    assert send(client, token, 2, b"").status_code == 422
    assert send(client, token, 2, b"c").status_code == 409
    assert submit(client, token, "think_aloud", {"agreed": True, "problem": "loud"}).status_code == 422
