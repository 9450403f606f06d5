"""Somebody watches two videos of a real robot in a real Chromium, and chooses; the videos are recorded there, too."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import httpx
import pytest
from playwright.sync_api import expect
from sqlalchemy import select

from desirepath.recordings.importing import import_recordings
from desirepath.settings import Settings
from desirepath.store.models import Event, Response, Study
from desirepath.store.query_sets import save_query_set
from desirepath.study.session.joining import join_study
from desirepath.study.studies import create_study
from desirepath.web.application import build_services, create_application
from desirepath.web.core.dependencies import Services
from tests.running import served, until
from tests.study.small_protocol import small_protocol

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

SECONDS = 1.6
RECORD = """async ([kind, colour, seconds]) => {
  const canvas = Object.assign(document.createElement("canvas"), { width: 160, height: 120 });
  const pen = canvas.getContext("2d");
  let at = 0;
  const draw = setInterval(() => {
    pen.fillStyle = colour; pen.fillRect(0, 0, 160, 120);
    pen.fillStyle = "white"; pen.fillRect((at += 4) % 160, 50, 20, 20);
  }, 40);
  const recorder = new MediaRecorder(canvas.captureStream(25), { mimeType: kind, videoBitsPerSecond: 200000 });
  const parts = [];
  recorder.ondataavailable = (event) => parts.push(event.data);
  const over = new Promise((resolve) => (recorder.onstop = resolve));
  recorder.start();
  await new Promise((resolve) => setTimeout(resolve, seconds * 1000));
  recorder.stop();
  await over;
  clearInterval(draw);
  const bytes = new Uint8Array(await new Blob(parts).arrayBuffer());
  return btoa(Array.from(bytes, (one) => String.fromCharCode(one)).join(""));
}"""


def film(page: Page, kind: str, colour: str) -> bytes:
    return base64.b64decode(page.evaluate(RECORD, [kind, colour, SECONDS]))


@pytest.fixture(scope="module")
def films(chromium: Browser, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two videos and their list: one WebM, one MP4 where this Chromium writes it."""
    folder, page = tmp_path_factory.mktemp("films"), chromium.new_page()
    second = page.evaluate("MediaRecorder.isTypeSupported('video/mp4;codecs=vp9')")
    ending, kind = ("mp4", "video/mp4;codecs=vp9") if second else ("webm", "video/webm;codecs=vp8")
    (folder / "left.webm").write_bytes(film(page, "video/webm;codecs=vp8", "navy"))
    (folder / f"right.{ending}").write_bytes(film(page, kind, "darkred"))
    (folder / "pairs.csv").write_text(f"a,b\nleft.webm,right.{ending}\n")  # this Chromium writes how long they are
    page.close()
    return folder


@pytest.fixture
def services(tmp_path: Path, films: Path) -> Iterator[Services]:
    found = build_services(Settings(data=tmp_path / "data", worker=False, _env_file=None))
    imported = import_recordings(films, "study_room")
    imported.query_set.save(tmp_path / "films.npz")
    block = {"block": {"view": "top_down", "trials": [{"queries": {"count": 1}}]}}
    frozen = small_protocol(tmp_path, [block], query_set=str(tmp_path / "films.npz"))
    with found.database.transaction() as s:
        save_query_set(s, found.files, imported.query_set, name="Films", card={}, videos=imported.videos)
        create_study(s, found.files, frozen, name="Films", created_by=None)
    yield found
    found.database.close()


@pytest.fixture
def address(services: Services) -> Iterator[str]:
    with served(create_application(services)) as url:
        yield url


def join(services: Services) -> str:
    with services.database.transaction() as s:
        return join_study(s, s.scalars(select(Study)).one(), language="en", files=services.files)[1]


def to_the_pair(page: Page, address: str, token: str) -> None:
    agreed(address, token)
    page.goto(f"{address}/p/{token}")
    expect(page.locator("#start")).to_have_attribute("aria-disabled", "false")


def agreed(address: str, token: str) -> None:
    consent = {"request_id": token[:32], "value": {"given": True, "version": "1"}, "client_time": None}
    answered = httpx.post(f"{address}/api/session/{token}/steps/consent", json=consent)
    assert answered.status_code == 200, answered.text


def watched(page: Page, letter: str) -> None:
    expect(page.locator("#playing-letter")).to_have_text(letter, timeout=15_000)
    expect(page.get_by_label(f"Video {letter}")).to_be_visible()


def test_both_videos_are_watched_after_a_reload_from_the_beginning_and_one_is_chosen(
    chromium, services, address, tmp_path
):
    page = chromium.new_context(viewport={"width": 1024, "height": 640}).new_page()
    to_the_pair(page, address, join(services))
    assert page.locator("iframe").count() == 0
    page.locator("#start").click()
    watched(page, "A")
    until(lambda: page.evaluate("document.querySelector('video').currentTime") > 0.3)
    assert page.locator("video").get_attribute("controls") is None
    page.screenshot(path=tmp_path / "video.png")
    page.locator(".pick[data-choice=a]").click(force=True)  # does not count yet
    watched(page, "B")
    page.reload()
    expect(page.locator("#start-hint-text")).to_contain_text("starts over")
    page.locator("#start").click()
    watched(page, "A")
    watched(page, "B")
    expect(page.locator("#question")).to_be_visible(timeout=20_000)
    page.locator(".pick[data-choice=b]").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("debriefing")
    with services.database.session() as s:
        assert s.scalars(select(Response).where(Response.kind == "preference")).one().value["choice"] == "b"
        seen = [event.data["side"] for event in s.scalars(select(Event).where(Event.kind == "trajectory_seen"))]
        assert sorted(seen) == ["a", "a", "b"]  # of the first B nothing counts
    page.context.close()


def test_a_video_is_sent_by_ranges_while_it_is_shown_and_to_nobody_else(services, address):
    token, api = join(services), f"{address}/api/session"
    with httpx.Client() as client:
        agreed(address, token)
        state = client.get(f"{api}/{token}").json()
        key, videos = state["step"]["key"], state["step"]["trial"]["videos"]
        assert state.get("stage_url") is None
        assert client.get(address + videos["a"]).status_code == 409  # not yet
        started = client.post(f"{api}/{token}/trials/{key}/start", json={"request_id": "s" * 32}).json()
        whole = client.get(address + videos["a"])
        assert whole.status_code == 200
        assert whole.headers["content-type"] in ("video/webm", "video/mp4")
        assert whole.headers["x-content-type-options"] == "nosniff"
        assert whole.headers["cache-control"] == "no-store"
        part = client.get(address + videos["a"], headers={"Range": "bytes=10-19"})
        assert (part.status_code, part.content) == (206, whole.content[10:20])
        assert part.headers["content-range"] == f"bytes 10-19/{len(whole.content)}"
        assert client.get(address + videos["a"], headers={"Range": "bytes=-5"}).content == whole.content[-5:]
        for wrong in (f"bytes={len(whole.content)}-", "bytes=9-3", "bytes=-", "lines=1-2", "bytes=0-1,4-5"):
            assert client.get(address + videos["a"], headers={"Range": wrong}).status_code == 416
        assert client.get(address + videos["b"]).status_code == 409  # its turn comes
        assert client.get((address + videos["a"]).replace(token, "x" * len(token))).status_code == 404
        playback = started["step"]["trial"]["playback_id"]
        early = client.post(f"{api}/{token}/trials/{key}/seen", json={"side": "a", "playback_id": playback})
        assert early.json()["error"]["code"] == "too_early"
        other = join(services)
        assert client.get((address + videos["a"]).replace(token, other)).status_code == 409
