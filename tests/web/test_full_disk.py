"""The disk is full while people answer: nothing is lost, it is said plainly, and it goes on once there is room."""

from __future__ import annotations

import errno
import tempfile
from collections import namedtuple

import pytest
from sqlalchemy import event, select

from desirepath.store.models import Response
from desirepath.web.core import disk
from desirepath.web.lab import drafts
from tests.web.lab_services import csrf
from tests.web.participant_services import submit

Usage = namedtuple("Usage", "total used free")


@pytest.fixture
def no_room(services):
    """SQLite's own refusal to grow its file, as on a disk without room."""

    def stop_growing(connection, _record):
        connection.execute("PRAGMA max_page_count = 1")  # no less than there are already

    event.listen(services.database.engine, "connect", stop_growing)
    services.database.engine.dispose()
    yield
    event.remove(services.database.engine, "connect", stop_growing)
    services.database.engine.dispose()


def test_an_answer_that_finds_no_room_is_refused_plainly_and_counts_later(client, services, token, no_room):
    long_report = {"text": "x" * 3900}
    for _ in range(10):
        refused = client.post(f"/api/session/{token}/problem", json=long_report)
        if refused.status_code != 204:
            break
    assert (refused.status_code, refused.json()["error"]["code"]) == (507, "disk_full")
    assert "full" in refused.json()["error"]["message"]
    assert refused.headers["retry-after"]
    shown = client.get(f"/p/{token}", headers={"Accept-Language": "de"})
    assert shown.status_code in (200, 507)
    services.database.engine.dispose()


def test_what_was_refused_is_stored_once_there_is_room_again(client, services, token):
    def no_room(*_args):
        raise OSError(errno.ENOSPC, "No space left on device")

    event.listen(services.database.engine, "before_cursor_execute", no_room)
    answered = submit(client, token, "information", {}, "the-same-request")
    page = client.get(f"/p/{token}")
    event.remove(services.database.engine, "before_cursor_execute", no_room)
    assert (answered.status_code, page.status_code) == (507, 507)
    assert "no room" in page.text
    assert submit(client, token, "information", {}, "the-same-request").json()["accepted"] is True
    with services.database.session() as s:
        assert len(s.scalars(select(Response)).all()) == 1


def test_health_and_the_signed_in_pages_say_how_much_room_there_is(lab, monkeypatch):
    def with_free(megabytes):
        monkeypatch.setattr(disk.shutil, "disk_usage", lambda _: Usage(10**12, 0, megabytes * 2**20))
        health = lab.get("/health")
        return health.status_code, health.json()["status"], lab.get("/lab/studies").text

    assert with_free(5000)[:2] == (200, "ok")
    assert 'role="alert"' not in with_free(5000)[2]
    code, status, page = with_free(50)
    assert (code, status) == (200, "disk_low")
    assert "Only 50 MB are free" in page
    code, status, page = with_free(2)
    assert (code, status) == (507, "disk_full")
    assert "disk is full" in page.replace("&#39;", "'")


@pytest.fixture
def full_drafts(small_disk, lab_services, monkeypatch):
    """Drafts and uploads on a real disk of 1 MB; calling it leaves so many kB."""
    (lab_services.settings.data / "drafts").symlink_to(small_disk)
    monkeypatch.setattr(tempfile, "tempdir", str(small_disk))

    def leave(kilobytes):
        (small_disk / "filler").write_bytes(b"x" * (disk.shutil.disk_usage(small_disk).free - kilobytes * 1024))

    return leave


@pytest.mark.parametrize("kilobytes", [0, 40, 400])
def test_a_new_protocol_that_finds_no_room_is_refused_plainly_and_leaves_nothing(
    lab, full_drafts, small_disk, kilobytes
):
    """It was a 500, and half a draft stayed; an upload was the sender's fault (400)."""
    token = csrf(lab)
    full_drafts(kilobytes)
    chosen = lab.post("/lab/new", data={"csrf": token, "source": "shipped:quick_preference_study"})
    big = {"protocol": ("protocol.yaml", b"#" * 1_500_000)}  # more than Starlette holds in memory
    uploaded = lab.post("/lab/new", data={"csrf": token, "source": "upload"}, files=big)
    assert (chosen.status_code, uploaded.status_code) == (507, 507)
    assert "no room" in chosen.text
    assert "Free some space on the server" in chosen.text, "what they can do, in their own frame"
    assert "Go to the studies" in uploaded.text
    german = {"Accept-Language": "de"}
    again = lab.post("/lab/new", data={"csrf": token, "source": "shipped:quick_preference_study"}, headers=german)
    assert "Schaffen Sie Platz" in again.text
    assert [one.name for one in small_disk.iterdir()] == ["filler"]


def test_a_draft_whose_changes_find_no_room_stays_as_it_was(lab, lab_services, full_drafts, small_disk):
    """The file was emptied before the new text found no room."""
    token = csrf(lab)
    draft = drafts.draft_from_shipped(lab_services.settings.data, "quick_preference_study")
    before = draft.yaml
    full_drafts(8)
    form = {"csrf": token, "yaml": f"{before}#{'x' * 100_000}"}
    assert lab.post(f"/lab/new/{draft.id}", data=form).status_code == 507
    assert lab.post(f"/lab/new/{draft.id}/power", data={"csrf": token}).status_code == 507
    assert draft.yaml == before
