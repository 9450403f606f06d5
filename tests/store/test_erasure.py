"""A participant is erased: nothing of them is in any file afterwards, and nobody else loses anything."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
from sqlalchemy import func, select

from desirepath.learning.queries.queries import Query, QuerySet
from desirepath.store.artefacts import ArtefactError, ArtefactStore, load_artefact, save_trajectory
from desirepath.store.database import COMPACT_PENDING, Database
from desirepath.store.dataset.writing import export_study
from desirepath.store.demonstration_snapshots import read_demonstrations
from desirepath.store.erasure import ErasureError, erase_participant
from desirepath.store.events import log_event
from desirepath.store.models import (
    Artefact,
    Erasing,
    Event,
    Job,
    JobMetric,
    Participant,
    RecruitingId,
    Response,
    Setting,
    Tombstone,
    TrajectoryRow,
)
from desirepath.store.outbox import enqueue_job
from desirepath.store.query_sets import queries_of, save_query_set
from desirepath.store.simulated_demonstrations import take_simulated_demonstrations
from desirepath.store.snapshots import load_snapshot, take_snapshot
from tests.store.small_study import SmallStudy, trajectory

CANARY = "canary-7f3a-planted"


def files_with(folder: Path, *words: str) -> list[str]:
    """Names of files under the folder that hold one of the words."""
    return [
        f"{path.relative_to(folder)}: {word}"
        for path in sorted(folder.rglob("*"))
        if path.is_file()
        for word in words
        if word.encode() in path.read_bytes()
    ]


def all_ids(database: Database, table: type) -> set[str]:
    with database.session() as s:
        return set(s.scalars(select(table.id)))


def test_nothing_of_an_erased_participant_is_left_in_any_file(study: SmallStudy, tmp_path: Path):
    person, session = study.participant("P1", secret=CANARY)
    study.participant("P2", drives=100)
    with study.database.transaction() as s:
        snapshot = take_snapshot(s, study.files, session_id=session).id
    policy = study.model(snapshot, card={"note": CANARY})
    with study.database.transaction() as s:
        job = enqueue_job(s, "align", {"snapshot": snapshot, "note": CANARY}, session_id=session)
        job.result = {"policy": policy}
        s.add(JobMetric(job_id=job.id, step=1, name="loss", value=0.5))
        own_drive = save_trajectory(s, study.files, trajectory(900), made_by=policy).id
        by_hand = enqueue_job(s, "evaluate", {"policies": [policy, "base"]}, study_id=study.id, created_by="analyst").id
        log_event(s, "job_started", study_id=study.id, job=job.id)
    logs = tmp_path / "logs" / "jobs"
    logs.mkdir(parents=True)
    (logs / f"{job.id}.log").write_text(CANARY)
    (tmp_path / "checkpoints" / job.id).mkdir(parents=True)
    (tmp_path / "checkpoints" / job.id / "weights.bin").write_text(CANARY)
    with study.database.session() as s:
        response = s.scalars(select(Response.id).where(Response.session_id == session)).first()
    gone = (CANARY, person, session, snapshot, policy, job.id, by_hand, own_drive, response)
    assert len({word for name in files_with(tmp_path, *gone) for word in gone if name.endswith(word)}) >= 8

    done = erase_participant(study.database, study.files, person, by="tester")

    assert files_with(tmp_path, *gone) == []
    assert [str(p) for p in tmp_path.rglob("*") if any(word in p.name for word in gone)] == []
    assert done["compacted"]
    assert done["counts"]["sessions"] == 1
    assert done["counts"]["responses"] == 6
    assert done["counts"]["artefacts"] == 2
    assert done["counts"]["jobs"] == 2
    assert done["counts"]["job_files"] == 2
    with study.database.session() as s:
        assert s.scalars(select(Participant.code)).all() == ["P2"]
        assert s.scalars(select(Job)).all() == []
        tombstone = s.scalars(select(Tombstone)).one()
        assert (tombstone.id, tombstone.erased_by) == (done["tombstone"], "tester")
        assert s.scalars(select(Erasing)).all() == []
        assert s.get(Setting, COMPACT_PENDING) is None


def test_the_others_keep_everything(study: SmallStudy):
    person, _ = study.participant("P1", secret=CANARY)
    _, kept = study.participant("P2", drives=100)
    database = study.database

    def of_others() -> tuple[object, ...]:
        with database.session() as s:
            answers = s.execute(select(Response.id, Response.value).where(Response.session_id == kept)).all()
            events = s.execute(select(Event.kind, Event.data).where(Event.session_id == kept)).all()
            ids = s.scalars(select(RecruitingId.external_id).where(RecruitingId.external_id.contains("P2"))).all()
        return answers, events, ids

    before = of_others()
    erase_participant(database, study.files, person, by="tester")
    assert of_others() == before
    for name in all_ids(database, TrajectoryRow):
        study.files.get(name)


def test_drives_that_others_saw_or_a_query_set_holds_stay(study: SmallStudy):
    person, _ = study.participant("P1", drives=0)  # drives 0 to 9
    study.participant("P2", drives=8)  # 8 to 17
    with study.database.transaction() as s:
        pairs = (Query(trajectory(0).scene, trajectory(0), trajectory(1), (0, 1)),)
        query_set = save_query_set(s, study.files, QuerySet("study_room", pairs, {}), name="mine", card={})
    done = erase_participant(study.database, study.files, person, by="tester")
    assert done["counts"]["trajectories"] == 6
    left = all_ids(study.database, TrajectoryRow)
    assert left == {trajectory(seed).digest() for seed in (0, 1, *range(8, 18))}
    assert set(study.files.names()) == left | {query_set.id}
    with study.database.session() as s:
        assert len(queries_of(s, study.files, query_set.id)) == 1


def test_pooled_models_are_quarantined_and_their_snapshot_is_taken_again(study: SmallStudy, tmp_path: Path):
    person, _ = study.participant("P1")
    study.participant("P2", drives=100)
    _, other_session = study.participant("P3", drives=200)
    with study.database.transaction() as s:
        pooled = take_snapshot(s, study.files, study_id=study.id).id
        alone = take_snapshot(s, study.files, session_id=other_session).id
    accuracy = {"held_out": [{"participant": "P1", "accuracy": 0.8}, {"participant": "P2", "accuracy": 0.9}]}
    policy = study.model(study.model(pooled, kind="reward_model", card=accuracy))
    untouched = study.model(alone)
    with study.database.transaction() as s:
        job = enqueue_job(s, "align", {"snapshot": pooled}, study_id=study.id, created_by="analyst").id

    done = erase_participant(study.database, study.files, person, by="tester")

    assert set(done["quarantined"]) >= {pooled, policy}
    assert len(done["quarantined"]) == 3
    with study.database.session() as s:
        for artefact_id in done["quarantined"]:
            with pytest.raises(ArtefactError, match="quarantined"):
                load_artefact(s, study.files, artefact_id)
        assert load_artefact(s, study.files, untouched)[0].quarantined_at is None
        again = load_snapshot(s, study.files, done["replaced"][pooled])
        assert {answer.participant for answer in again.answers} == {"P2", "P3"}
        reward_model = s.scalars(select(Artefact).where(Artefact.kind == "reward_model")).one()
        assert reward_model.card == {"held_out": [{"participant": "P2", "accuracy": 0.9}]}
        assert s.get(Job, job) is not None
    assert not study.files.exists(pooled)  # it held the answers themselves
    assert study.files.exists(policy)


def test_a_snapshot_with_too_few_answers_left_gets_no_successor(study: SmallStudy):
    person, _ = study.participant("P1")
    study.participant("P2", choices="a", drives=100)
    with study.database.transaction() as s:
        pooled = take_snapshot(s, study.files, study_id=study.id).id
    done = erase_participant(study.database, study.files, person, by="tester")
    assert done["quarantined"] == (pooled,)
    assert done["replaced"] == {}


def test_a_job_that_ends_after_the_erasure_cannot_save_what_it_learned(study: SmallStudy):
    person, session = study.participant("P1")
    with study.database.transaction() as s:
        snapshot = take_snapshot(s, study.files, session_id=session).id
    erase_participant(study.database, study.files, person, by="tester")
    with pytest.raises(ArtefactError, match="was it erased"):
        study.model(snapshot)
    assert list(study.files.names()) == []


def test_an_erasure_cut_short_can_be_repeated(study: SmallStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    person, session = study.participant("P1", secret=CANARY)
    study.participant("P2", drives=100)
    with study.database.transaction() as s:
        pooled = take_snapshot(s, study.files, study_id=study.id).id

    def die(*_: object) -> None:
        raise KeyboardInterrupt

    # There is no other way to stop between the files and the commit.
    monkeypatch.setattr("desirepath.store.erasure.replace_artefacts", die)
    with pytest.raises(KeyboardInterrupt):
        erase_participant(study.database, study.files, person, by="tester")
    assert person in all_ids(study.database, Participant)
    assert not study.files.exists(pooled)
    monkeypatch.undo()
    done = erase_participant(study.database, study.files, person, by="tester")
    assert files_with(tmp_path, CANARY, person, session) == []
    with study.database.session() as s:
        assert len(load_snapshot(s, study.files, done["replaced"][pooled]).answers) == 4


def test_a_vacuum_that_was_cut_short_is_done_at_the_next_start(
    study: SmallStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    person, _ = study.participant("P1", secret=CANARY)
    monkeypatch.setattr(Database, "compact", lambda self: False)  # as if a reader had stayed all the while
    assert not erase_participant(study.database, study.files, person, by="tester")["compacted"]
    monkeypatch.undo()
    study.database.close()
    Database(str(study.database.url)).migrate()
    assert files_with(tmp_path, CANARY) == []


def programmed(s, files: ArtefactStore) -> str:
    """The file of the one demonstration in a snapshot of a programmed demonstrator's."""
    snapshot = take_simulated_demonstrations(s, files, style="field_of_view", environment="room", per_pair=1, seed=0)
    return read_demonstrations(files.get(snapshot.id))[1][0].demonstration


def test_files_that_a_crash_left_without_a_row_go_once_they_are_old(study: SmallStudy, tmp_path: Path):
    person, _ = study.participant("P1")
    old, fresh = study.files.put(b"left behind"), study.files.put(b"being saved right now")
    with study.database.transaction() as s:
        needed = programmed(s, study.files)
    for name in (old, needed):
        os.utime(tmp_path / "artefacts" / name[:2] / name, (time.time() - 7200, time.time() - 7200))
    assert erase_participant(study.database, study.files, person, by="tester")["counts"]["orphans"] == 1
    assert not study.files.exists(old)
    assert study.files.exists(fresh)
    assert study.files.exists(needed)  # a snapshot of a programmed demonstrator names it, no row does


def test_an_export_after_the_erasure_counts_it_and_no_more(study: SmallStudy, tmp_path: Path):
    person, _ = study.participant("P1", secret=CANARY)
    study.participant("P2", drives=100)
    erase_participant(study.database, study.files, person, by="tester")
    export_study(study.database, study.files, study.id, tmp_path / "out")
    assert files_with(tmp_path / "out", CANARY, "P1,", person) == []
    assert '"tombstone"' in (tmp_path / "out" / "study.json").read_text()


def test_an_unknown_participant_and_an_unknown_data_folder_are_told(study: SmallStudy):
    with pytest.raises(LookupError, match="no participant"):
        erase_participant(study.database, study.files, "nobody", by="tester")
    somewhere_else = Database("postgresql://nobody@127.0.0.1:1/nothing")  # never connected to
    with pytest.raises(ErasureError, match="name the data folder"):
        erase_participant(somewhere_else, study.files, "nobody", by="tester")


def test_the_same_person_may_take_part_again_after_an_erasure(study: SmallStudy):
    person, _ = study.participant("P1")
    erase_participant(study.database, study.files, person, by="tester")
    study.participant("P1")
    with study.database.session() as s:
        assert s.scalar(select(func.count()).select_from(RecruitingId)) == 1


def test_a_participant_of_the_same_code_in_another_study_keeps_their_jobs(study: SmallStudy):
    person, _ = study.participant("P1")
    elsewhere = SmallStudy(study.database, study.files)
    elsewhere.participant("P1", drives=100)
    with study.database.transaction() as s:
        enqueue_job(s, "reward_model", {"only": ["P1"]}, study_id=study.id)
        others = enqueue_job(s, "reward_model", {"only": ["P1"]}, study_id=elsewhere.id).id
        nobodys = enqueue_job(s, "reward_model", {"only": ["P1"]}).id
    erase_participant(study.database, study.files, person, by="tester")
    assert all_ids(study.database, Job) == {others, nobodys}


def test_what_an_erased_policy_made_is_not_stored_any_more(study: SmallStudy):
    person, session = study.participant("P1")
    with study.database.transaction() as s:
        snapshot = take_snapshot(s, study.files, session_id=session).id
    policy = study.model(snapshot)
    erase_participant(study.database, study.files, person, by="tester")
    before = list(study.files.names())
    with pytest.raises(ArtefactError, match="was it erased"), study.database.transaction() as s:
        save_trajectory(s, study.files, trajectory(900), made_by=policy)
    assert list(study.files.names()) == before
