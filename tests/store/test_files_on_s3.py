"""Artefacts, exports and backups on an S3-compatible store (moto's on loopback): the same ids, or a plain word."""

from __future__ import annotations

import contextlib
import hashlib
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from sqlalchemy import select

from desirepath.store.artefacts import ArtefactError, ArtefactStore
from desirepath.store.backup import backup, restore
from desirepath.store.database import Database, StorageError
from desirepath.store.dataset.reading import read_dataset
from desirepath.store.dataset.writing import export_study
from desirepath.store.models import Response
from desirepath.store.places import StoreAway, read_from, write_to
from tests.s3 import BUCKET, S3, s3_store
from tests.store.small_study import SmallStudy


@pytest.fixture(scope="module")
def shared() -> Iterator[S3]:
    with s3_store() as store:
        yield store


def test_a_file_has_the_same_name_there_as_on_a_disk(shared: S3, tmp_path: Path) -> None:
    there, here = ArtefactStore(shared.url), ArtefactStore(tmp_path.as_uri())
    contents = [b"one", b"two", b"one", bytes(2**20)]
    assert there.put_all(contents) == here.put_all(contents)
    assert list(there.names()) == list(here.names())
    sha = there.put(b"one")
    assert (there.get(sha), there.exists(sha), there.exists("0" * 64)) == (b"one", True, False)
    assert -5 < there.age_s(sha, time.time()) < 60
    there.delete(sha)
    assert not there.exists(sha), "what was listed a moment ago says nothing"
    there.delete(sha)
    with pytest.raises(ArtefactError, match="not in the artefact store s3://"):
        there.get(sha)


def test_another_process_sees_at_once_what_one_has_written(shared: S3) -> None:
    store, sha = ArtefactStore(shared.url), hashlib.sha256(b"by another").hexdigest()
    assert not store.exists(sha)
    shared.client.put_object(Bucket=BUCKET, Key=f"desirepath/{sha[:2]}/{sha}", Body=b"by another")
    assert store.exists(sha)
    assert store.get(sha) == b"by another"


def test_a_signed_link_fetches_that_file_and_no_other(shared: S3) -> None:
    store = ArtefactStore(shared.url)
    sha, other = store.put_all([b"to be fetched", b"another"])
    link = store.link_to(sha, "policy.npz", seconds=60)
    fetched = httpx.get(link)
    assert fetched.content == b"to be fetched"
    assert fetched.headers["content-disposition"] == 'attachment; filename="policy.npz"'
    assert "Signature=" in link
    assert link.startswith(shared.address)
    assert sha in link
    assert other not in link


def test_a_disk_has_no_links(tmp_path: Path) -> None:
    store = ArtefactStore(tmp_path.as_uri())
    assert store.link_to(store.put(b"x"), "x", seconds=60) is None


def test_an_upload_that_is_cut_short_leaves_nothing_to_read(shared: S3, monkeypatch: pytest.MonkeyPatch) -> None:
    store, content = ArtefactStore(shared.url), b"a policy"
    sha = hashlib.sha256(content).hexdigest()
    asked = type(store._fs)._call_s3

    async def cut(self: object, method: str, *args: object, **named: object) -> object:
        if method in ("put_object", "upload_part", "complete_multipart_upload"):
            raise ConnectionResetError("the line was cut")
        return await asked(self, method, *args, **named)

    monkeypatch.setattr(type(store._fs), "_call_s3", cut)
    with pytest.raises(StoreAway, match="the line was cut"):
        store.put(content)
    monkeypatch.undo()
    assert not store.exists(sha)
    assert sha not in set(store.names())
    assert store.put(content) == sha


def test_a_store_that_goes_away_is_named() -> None:
    with s3_store() as store:
        files = ArtefactStore(store.url)
        sha = files.put(b"before")
        store.kill()
        for asked in (lambda: files.put(b"after"), lambda: files.get(sha), lambda: files.exists(sha)):
            with pytest.raises(StoreAway, match=r"artefact store s3://lab/desirepath: .*does it run") as said:
                asked()
            assert isinstance(said.value, StorageError)


def test_exports_and_backups_go_there_and_come_back(shared: S3, study: SmallStudy, tmp_path: Path) -> None:
    _, session = study.participant("P1")
    where = f"s3://{BUCKET}/exports/monday"
    with write_to(where) as folder:
        export_study(study.database, study.files, study.id, folder)
    with read_from(where) as fetched:
        assert len(read_dataset(fetched).tables["responses"]) == 6
    with pytest.raises(StorageError, match="something is there already"), write_to(where):
        pass
    saved = f"s3://{BUCKET}/backups/monday.tar"
    with write_to(saved) as file:
        backup(study.database, study.files, file)
    artefacts = f"s3://{BUCKET}/restored"
    with read_from(saved) as file:
        restore(file, tmp_path / "new", artefacts_url=artefacts)
    assert list(ArtefactStore(artefacts).names()) == list(study.files.names())
    with Database(f"sqlite:///{tmp_path / 'new' / 'desirepath.sqlite'}").session() as s:
        assert set(s.scalars(select(Response.session_id))) == {session}
    with pytest.raises(StorageError, match="nothing is there"), read_from(f"s3://{BUCKET}/backups/tuesday.tar"):
        pass


def test_an_export_that_fails_in_the_middle_leaves_nothing_that_reads_as_one(shared: S3) -> None:
    where = f"s3://{BUCKET}/exports/cut"
    with contextlib.suppress(InterruptedError), write_to(where) as folder:
        folder.mkdir()
        (folder / "half.csv").write_text("a,b")
        raise InterruptedError
    assert "Contents" not in shared.client.list_objects_v2(Bucket=BUCKET, Prefix="exports/cut")


@pytest.mark.parametrize("url", ["ftp2://lab/x", "what://"])
def test_a_store_that_nothing_here_can_read_is_refused(url: str) -> None:
    with pytest.raises(StorageError, match="known are file:///FOLDER and s3://BUCKET/FOLDER"):
        ArtefactStore(url)
