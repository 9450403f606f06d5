"""A job's page: curves in words with units, raw and averaged weights as two lines, time to go, TensorBoard files."""

from __future__ import annotations

import io
import re
import struct
import zipfile
from dataclasses import fields
from datetime import timedelta
from pathlib import Path

import pytest
from sqlalchemy import select
from typer.testing import CliRunner

from desirepath.cli.main import app
from desirepath.demonstrations.judging import Judgement
from desirepath.jobs.context import Progress
from desirepath.jobs.curves import UNTOLD, curves_of
from desirepath.jobs.tensorboard import crc32c
from desirepath.learning.td3.base import BaseConfig, train_base
from desirepath.settings import get_settings
from desirepath.store.models import Job, utc_now
from desirepath.store.outbox import enqueue_job
from desirepath.web.core.catalogues import Texts

FRONTEND = Path(__file__).resolve().parents[2] / "frontend"


@pytest.fixture
def training(lab_services) -> str:
    """A base training that has run for a minute and is 25 % done."""
    with lab_services.database.transaction() as s:
        job = enqueue_job(s, "train_base", {"setup": "study_room"})
        job.state, job.started_at = "running", utc_now() - timedelta(seconds=60)
    progress = Progress(lab_services.database, job.id)
    for updates in (100, 200):
        progress(updates / 800, {"updates": updates, "transitions": updates * 20.0, "critic_loss": 1 / updates})
        for averaged in (0.0, 1.0):
            told = {"averaged": averaged, "success_rate": updates / 800 + averaged / 4, "time_s": 9.0 - averaged}
            progress(updates / 800, {"updates": updates, "transitions": updates * 20.0, **told})
    progress.flush()
    return job.id


def test_raw_and_averaged_weights_are_two_lines(lab_services, training):
    with lab_services.database.session() as s:
        found = curves_of(s, training)
    assert found["success_rate"] == {"raw": [(100, 0.125), (200, 0.25)], "averaged": [(100, 0.375), (200, 0.5)]}
    assert found["critic_loss"] == {"": [(100, 0.01), (200, 0.005)]}
    assert found["transitions"] == {"": [(100, 2000.0), (200, 4000.0)]}  # the same for both, so told once
    assert "averaged" not in found


@pytest.mark.parametrize(
    ("language", "words"),
    [
        (
            "en",
            ["Success (share of selection scenes)", "Updates", "raw weights", "averaged weights", "to go"],
        ),
        ("de", ["Erfolg (Anteil der Auswahlszenen)", "gemittelte Gewichte", "Noch etwa", "Critic-Loss"]),
    ],
)
def test_the_page_says_what_is_drawn_and_how_long_it_takes(lab, training, language, words):
    page = lab.get(f"/lab/jobs/{training}", headers={"Accept-Language": language}).text
    for word in words:
        assert word in page
    assert "success_rate<" not in page
    csv = lab.get(f"/lab/jobs/{training}/curves/success_rate.csv").text
    assert csv.splitlines() == ["updates,success_rate_raw,success_rate_averaged", "100,0.125,0.375", "200,0.25,0.5"]
    assert lab.get(f"/lab/jobs/{training}/curves/success_rate.svg").text.count("<polyline") == 2
    assert lab.get(f"/lab/jobs/{training}/curves/none.svg").status_code == 404
    to_go = re.search(r"About (.*?) min to go", lab.get(f"/lab/jobs/{training}").text)
    assert to_go is not None
    assert 2.9 < float(to_go[1]) < 3.4


def test_only_a_search_is_scored_against_the_instant_policy(lab, lab_services):
    told = {}
    for kind, params in (("align", {"recipe": "conditioning_search"}), ("train_demonstrations", {"snapshot": "x"})):
        with lab_services.database.transaction() as s:
            job = enqueue_job(s, kind, params).id
        progress = Progress(lab_services.database, job)
        for step in (16, 32):
            progress(step / 100, {"tried" if kind == "align" else "updates": step, "score": step / 10})
        progress.flush()
        told[kind] = lab.get(f"/lab/jobs/{job}").text
    assert "Score against the instant policy" in told["align"]
    assert "Candidates tried" in told["align"]
    assert "instant policy" not in told["train_demonstrations"]
    assert "Selection score" in told["train_demonstrations"]


def test_every_metric_of_a_training_has_words_in_both_languages():
    reported: set[str] = set()

    def collect(_: float, metrics: dict[str, float] | None = None) -> None:
        reported.update(metrics or {})

    small = {"n_envs": 32, "random_transitions": 2_000, "smoothing_updates": 10, "selection_scenes": 20}
    config = BaseConfig("study_room", updates=110, updates_per_step=1, checkpoints=1, **small)
    train_base(config, collect)
    assert {"critic_loss", "actor_loss"} <= reported
    reported |= {field.name for field in fields(Judgement)}
    reported |= {"unseen_success_rate", "score", "preferred", "shorter", "gained"}
    for language in ("en", "de"):
        t = Texts(FRONTEND / "locales").get(language)
        wordless = {
            name
            for name in reported - {"updates", *UNTOLD}
            if not (t.knows(f"curves.metrics.{name}") or t.knows(f"analyst.metrics.{name}"))
        }
        assert not wordless


def records(content: bytes) -> list[bytes]:
    """The records of an event file, their checksums checked."""
    found, at = [], 0

    def masked(data: bytes) -> int:
        crc = crc32c(data)
        return ((crc >> 15 | crc << 17) + 0xA282EAD8) & 0xFFFFFFFF

    while at < len(content):
        (length,) = struct.unpack_from("<Q", content, at)
        assert struct.unpack_from("<I", content, at + 8)[0] == masked(content[at : at + 8])
        data = content[at + 12 : at + 12 + length]
        assert struct.unpack_from("<I", content, at + 12 + length)[0] == masked(data)
        found.append(data)
        at += 16 + length
    return found


def test_curves_are_taken_away_as_tensorboard_files(lab, lab_services, training, tmp_path, monkeypatch):
    assert crc32c(b"123456789") == 0xE3069283
    packed = zipfile.ZipFile(io.BytesIO(lab.get(f"/lab/jobs/{training}/tensorboard.zip").content))
    runs = {Path(name).parent.as_posix(): records(packed.read(name)) for name in packed.namelist()}
    assert set(runs) == {training[:8], f"{training[:8]}/raw", f"{training[:8]}/averaged"}
    header, *points = runs[f"{training[:8]}/averaged"]
    assert header.endswith(b"brain.Event:2")
    assert len(points) == 4  # two metrics at two steps
    assert points[0][10:12] == b"\x64\x2a"  # step 100
    assert b"success_rate\x15" + struct.pack("<f", 0.375) in points[0]
    monkeypatch.setenv("DESIREPATH_DATA", str(lab_services.settings.data))
    monkeypatch.setenv("DESIREPATH_DATABASE_URL", lab_services.database.url.render_as_string(hide_password=False))
    get_settings.cache_clear()
    try:
        told = CliRunner().invoke(app, ["jobs", "export", training, "--out", str(tmp_path / "logs")])
        unknown = CliRunner().invoke(app, ["jobs", "export", "none", "--out", str(tmp_path / "logs")])
    finally:
        get_settings.cache_clear()
    assert told.exit_code == 0, told.output
    assert len(list((tmp_path / "logs").rglob("events.out.tfevents.*"))) == 3
    assert unknown.exit_code == 1
    assert "no job with id 'none'" in unknown.stderr


def test_settings_left_open_say_what_was_taken(lab, lab_services, two_studies):
    with lab_services.database.transaction() as s:
        job = s.get_one(Job, two_studies.job["ours"])
        job.params = {"snapshot": two_studies.snapshot["ours"], "recipe": "instant"}
    page = lab.get(f"/lab/jobs/{job.id}").text
    row = re.search(r'<th scope="row">Base policy</th>\s*<td>(.*?)</td>', page, re.S)
    assert row is not None
    assert f"/lab/policies/{two_studies.base}" in row[1]
    assert "(automatic)" in row[1]
    conditioned = re.search(r'<th scope="row">Conditioned policy</th>\s*<td>(.*?)</td>', page, re.S)
    assert conditioned is not None
    assert "study_room/conditioned" in conditioned[1]


def test_jobs_are_found_by_whose_answers_they_learn_from_and_sorted_by_their_headline(
    lab, lab_services, walked, two_studies
):
    def predicted(share: float, verdict: str) -> dict[str, object]:
        said = {"accuracy": share, "verdict": verdict}
        return {"policy": "p", "passed": True, "predicted": said, "gate": {"success_rate": 0.97}}

    with lab_services.database.transaction() as s:
        for job in s.scalars(select(Job)):
            job.state = "cancelled"
        for share, verdict in ((0.51, "no_better_than_chance"), (0.74, "better"), (0.62, "better")):
            made = enqueue_job(s, "align", {"recipe": "instant"}, study_id=walked.id)
            made.state, made.result = "succeeded", predicted(share, verdict)
    page = lab.get("/lab/jobs?sort=-headline&recipe=instant").text
    assert re.findall(r"(\d\d)% <span[^>]*>held-out accuracy", page) == ["74", "62", "51"]
    assert page.count("not distinguishable from chance") == 1
    theirs = lab.get(f"/lab/jobs?participant={walked.finished}").text
    assert two_studies.job["ours"] in theirs  # by its snapshot, though no session of theirs started it
    assert "sort=-participant" in lab.get("/lab/jobs?sort=participant").text
