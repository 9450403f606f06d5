"""Files named by their content, artefacts with lineage, the log, the outbox, shipped things and snapshots."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from sqlalchemy import func, select, update

from desirepath.learning.queries.queries import Query, QuerySet
from desirepath.simulation.setups import SetupError
from desirepath.store.artefacts import (
    ArtefactError,
    ArtefactStore,
    lineage,
    load_artefact,
    load_trajectory,
    save_artefact,
    save_trajectory,
)
from desirepath.store.database import Database, StorageError
from desirepath.store.events import log_event
from desirepath.store.models import (
    Artefact,
    Event,
    Job,
    Participant,
    Response,
    Session,
    TrajectoryRow,
    Trial,
    utc_now,
)
from desirepath.store.outbox import cancel_job, enqueue_job
from desirepath.store.query_sets import import_query_set, queries_of, save_query_set
from desirepath.store.snapshots import (
    Snapshot,
    SnapshotError,
    check_whose,
    load_snapshot,
    set_aside_snapshots,
    take_snapshot,
)
from tests.store.small_study import SmallStudy, trajectory


def test_a_file_comes_back_by_its_hash_and_is_stored_once(files: ArtefactStore):
    first, second = files.put(b"weights"), files.put(b"weights")
    assert first == second
    assert files.get(first) == b"weights"
    assert list(files.names()) == [first]
    files.delete(first)
    files.delete(first)
    assert not files.exists(first)
    with pytest.raises(ArtefactError, match="is not in the artefact store"):
        files.get(first)


def test_a_damaged_file_is_never_handed_out(files: ArtefactStore, tmp_path: Path):
    sha = files.put(b"weights")
    (tmp_path / "artefacts" / sha[:2] / sha).write_bytes(b"weightz")
    with pytest.raises(ArtefactError, match="damaged"):
        files.get(sha)


@pytest.mark.parametrize("name", ["../../etc/passwd", "", "A" * 64, "0" * 63, "0" * 64 + "\n"])
def test_a_name_that_is_no_hash_never_becomes_a_path(files: ArtefactStore, name: str):
    with pytest.raises(ArtefactError, match="no sha256"):
        files.get(name)


def test_the_store_may_be_anywhere_that_fsspec_reaches():
    elsewhere = ArtefactStore("memory://desirepath-test")
    sha = elsewhere.put(b"far away")
    assert elsewhere.get(sha) == b"far away"
    assert list(elsewhere.names()) == [sha]


def test_a_store_that_cannot_be_written_says_so(tmp_path: Path):
    (tmp_path / "artefacts").write_text("a file where the folder should be")
    with pytest.raises(StorageError, match="check free space and permissions"):
        ArtefactStore((tmp_path / "artefacts").as_uri()).put(b"x")


def test_a_trajectory_comes_back_whole_and_is_stored_once(database: Database, files: ArtefactStore):
    drive = trajectory(5)
    for _ in range(2):
        with database.transaction() as s:
            row = save_trajectory(s, files, drive, made_by="policy")
    assert row.duration_s == pytest.approx(1.2)
    back = load_trajectory(files, row.id)
    assert back.scene == drive.scene
    assert back.to_bytes() == drive.to_bytes()
    with database.session() as s:
        assert s.scalar(select(func.count()).select_from(TrajectoryRow)) == 1


def test_lineage_walks_from_a_policy_to_the_answers(study: SmallStudy):
    _, session = study.participant("P1", choices="abba")
    with study.database.transaction() as s:
        snapshot = take_snapshot(s, study.files, session_id=session).id
    reward_model = study.model(snapshot, kind="reward_model")
    policy = study.model(reward_model)
    with study.database.session() as s:
        tree = lineage(s, policy)
        answers = s.scalars(select(Response.id).join(Trial).where(Trial.role == "regular")).all()
        assert [node.artefact.kind for node in (tree, tree.parents[0], tree.parents[0].parents[0])] == [
            "policy",
            "reward_model",
            "snapshot",
        ]
        assert tree.all_answers() == tuple(sorted(answers))
        with pytest.raises(ArtefactError, match="no artefact"):
            lineage(s, "unknown")


def test_saving_the_same_content_again_gives_the_same_artefact(database: Database, files: ArtefactStore):
    def save(**changes: object) -> Artefact:
        with database.transaction() as s:
            asked = {"kind": "policy", "name": "x", "setup": "study_room", "content": b"x", "card": {"seed": 1}}
            return save_artefact(s, files, **(asked | changes))

    assert save().id == save(name="y").id
    with pytest.raises(ArtefactError, match="same content is stored as policy"):
        save(kind="reward_model")
    with pytest.raises(ArtefactError, match="kind 'pickle' is unknown"):
        save(kind="pickle")
    with pytest.raises(ArtefactError, match="was it erased"):
        save(content=b"child", parents=[("0" * 64, "made_from")])
    with pytest.raises(ArtefactError, match="answers do not exist"):
        save(content=b"child", answers=["nobody"])


def test_what_is_made_from_simulated_answers_is_marked_to_the_last_policy(study: SmallStudy):
    _, session = study.participant("bot", simulated=True)
    with study.database.transaction() as s:
        snapshot = take_snapshot(s, study.files, session_id=session)
    policy = study.model(snapshot.id)
    with study.database.session() as s:
        assert s.get(Artefact, policy).simulated
        assert {answer.source for answer in load_snapshot(s, study.files, snapshot.id).answers} == {"simulated"}


def test_a_quarantined_artefact_is_neither_loaded_nor_built_upon(study: SmallStudy):
    _, session = study.participant("P1")
    with study.database.transaction() as s:
        snapshot = take_snapshot(s, study.files, session_id=session)
        snapshot.quarantined_at = utc_now()
    with pytest.raises(ArtefactError, match="quarantined"):
        study.model(snapshot.id)
    with study.database.session() as s, pytest.raises(ArtefactError, match="new snapshot"):
        load_artefact(s, study.files, snapshot.id)


def test_a_snapshot_holds_the_answers_that_count_and_says_what_it_left_out(study: SmallStudy):
    study.participant("P1", choices="abab")
    excluded, _ = study.participant("P2", choices="bb", drives=100)
    withdrawn, _ = study.participant("P3", choices="a", drives=200)
    study.participant("bot", choices="aa", drives=300, simulated=True)
    with study.database.transaction() as s:
        s.get(Participant, excluded).excluded_at = utc_now()
        s.get(Participant, withdrawn).withdrawn_at = utc_now()
        s.execute(update(Trial).where(Trial.step_key == "trial-4").values(role="repeat"))
    with study.database.transaction() as s:
        row = take_snapshot(s, study.files, study_id=study.id)
        again = take_snapshot(s, study.files, study_id=study.id)
    assert again.id == row.id
    assert not row.simulated
    assert row.name == "Passing people, 4 answers of P1"
    assert (row.card["whose"], row.card["participants"], row.card["human"]) == ("people", 1, 4)
    with study.database.session() as s:
        snapshot = load_snapshot(s, study.files, row.id)
        linked = set(lineage(s, row.id).answers)
    assert snapshot.whose == "people"
    assert [(a.participant, a.choice, a.source, a.probe) for a in snapshot.answers] == [
        ("P1", "a", "human", False),
        ("P1", "b", "human", False),
        ("P1", "a", "human", False),
        ("P1", "b", "human", True),
    ]
    assert snapshot.left_out == {
        "pilot": 0,
        "learning": 1,
        "excluded": 3,
        "withdrawn": 2,
        "no_consent": 0,
        "no_choice": 0,
        "people": 0,
        "simulated": 3,
    }
    assert linked == {answer.response for answer in snapshot.answers}
    second = snapshot.answers[1]
    assert (second.chosen, second.rejected) == (second.trajectory_b, second.trajectory_a)
    assert len(snapshot.training_answers()) == 3


def test_people_and_simulated_participants_are_mixed_only_on_demand(study: SmallStudy):
    study.participant("P1", choices="ab")
    _, session = study.participant("bot", choices="aab", drives=100, simulated=True)
    taken = {}
    with study.database.transaction() as s:
        for whose in ("people", "simulated", "all"):
            taken[whose] = take_snapshot(s, study.files, study_id=study.id, whose=whose)
        taken["session"] = take_snapshot(s, study.files, session_id=session)
        contents = {whose: load_snapshot(s, study.files, row.id) for whose, row in taken.items()}
    assert {whose: [a.participant for a in content.answers] for whose, content in contents.items()} == {
        "people": ["P1"] * 2,
        "simulated": ["bot"] * 3,
        "all": ["P1"] * 2 + ["bot"] * 3,
        "session": ["bot"] * 3,
    }
    assert [whose for whose, row in taken.items() if row.simulated] == ["simulated", "all", "session"]
    assert len({row.id for row in taken.values()}) == 4
    assert [row.name.partition(", ")[2] for row in taken.values()] == [
        "2 answers of P1",
        "3 answers of bot",
        "5 answers of 2 participants",
        "3 answers of bot",
    ]
    assert contents["simulated"].left_out["people"] == 3
    with pytest.raises(SnapshotError, match="answers = 'robots': must be one of people, simulated, all"):
        check_whose("robots")


def test_a_study_of_bots_alone_says_how_to_learn_from_them(study: SmallStudy):
    study.participant("bot", choices="aab", simulated=True)
    message = r"only 0 usable answers of people.*left out: 4 simulated.*--answers simulated"
    with pytest.raises(SnapshotError, match=message), study.database.transaction() as s:
        take_snapshot(s, study.files, study_id=study.id)


def test_nothing_more_is_learned_from_a_snapshot_once_somebody_in_it_withdraws(study: SmallStudy):
    first, session = study.participant("P1")
    study.participant("P2", drives=100)
    with study.database.transaction() as s:
        pooled = take_snapshot(s, study.files, study_id=study.id).id
        own = take_snapshot(s, study.files, session_id=session).id
    model = study.model(pooled, kind="reward_model")
    with study.database.transaction() as s:
        assert sorted(set_aside_snapshots(s, first)) == sorted([pooled, own])
        s.get(Participant, first).withdrawn_at = utc_now()
        assert set_aside_snapshots(s, first) == []
    with study.database.transaction() as s:
        for snapshot in (pooled, own):
            with pytest.raises(ArtefactError, match="erased or withdrawn; make it again from a new snapshot"):
                load_snapshot(s, study.files, snapshot)
        load_artefact(s, study.files, model)  # what was learned before stays
        again = take_snapshot(s, study.files, study_id=study.id)
        assert {answer.participant for answer in load_snapshot(s, study.files, again.id).answers} == {"P2"}


@pytest.mark.parametrize("choices", ["", "a"])
def test_a_snapshot_of_fewer_than_two_usable_answers_is_refused(study: SmallStudy, choices: str):
    _, session = study.participant("P1", choices=choices)
    message = f"only {len(choices)} usable answers of a session, at least 2 are needed .*1 learning"
    with pytest.raises(SnapshotError, match=message), study.database.transaction() as s:
        take_snapshot(s, study.files, session_id=session)


def test_a_snapshot_of_some_participants_leaves_the_others_out(study: SmallStudy):
    first, _ = study.participant("P1")
    study.participant("P2", drives=100)
    with study.database.transaction() as s:
        row = take_snapshot(s, study.files, study_id=study.id, participant_ids=[first])
        assert {answer.participant for answer in load_snapshot(s, study.files, row.id).answers} == {"P1"}
        with pytest.raises(LookupError, match="no study"):
            take_snapshot(s, study.files, study_id="unknown")


def test_a_snapshot_of_one_view_holds_what_was_answered_in_it(study: SmallStudy):
    study.participant("P1", choices="ababab")
    with study.database.transaction() as s:
        trials = list(s.scalars(select(Trial).order_by(Trial.index)))
        for trial in trials[::2]:
            trial.view = "immersive"
    with study.database.transaction() as s:
        every = load_snapshot(s, study.files, take_snapshot(s, study.files, study_id=study.id).id)
        row = take_snapshot(s, study.files, study_id=study.id, view="immersive")
        one = load_snapshot(s, study.files, row.id)
    assert row.name.endswith("in immersive")
    assert list(one.answers) == [answer for answer in every.answers if answer.view == "immersive"]
    assert 0 < len(one.answers) < len(every.answers)


def test_a_snapshot_never_mixes_setups(study: SmallStudy):
    _, session = study.participant("P1")
    with study.database.transaction() as s:
        other = save_trajectory(s, study.files, trajectory(77, setup="open_field"))
        s.execute(update(Trial).where(Trial.step_key == "trial-2").values(trajectory_a=other.id))
    with pytest.raises(SetupError, match="setups differ"), study.database.transaction() as s:
        take_snapshot(s, study.files, session_id=session)


def test_a_snapshot_of_another_format_is_refused():
    with pytest.raises(SnapshotError, match="not a snapshot of this version"):
        Snapshot.from_bytes(json.dumps({"format": "desirepath-snapshot-0", "answers": []}).encode())


def small_query_set(count: int = 3) -> QuerySet:
    queries = []
    for k in range(count):
        a, b = trajectory(10 + k), trajectory(60 + k)
        queries.append(Query(a.scene, a, b, (0, 1)))
    return QuerySet("study_room", tuple(queries), {})


def test_a_query_set_file_is_brought_in_once_and_its_queries_are_found(
    database: Database, files: ArtefactStore, tmp_path: Path
):
    path = tmp_path / "mine.npz"
    small_query_set().save(path)
    with database.transaction() as s:
        first = import_query_set(s, files, str(path))
    with database.transaction() as s:
        assert import_query_set(s, files, str(path)).id == first.id
        queries = queries_of(s, files, first.id)
        assert s.scalar(select(func.count()).select_from(TrajectoryRow)) == 6
    stored = QuerySet.load(path).queries
    assert [query.id for query in queries] == [query.digest() for query in stored]
    assert load_trajectory(files, queries[0].trajectory_b).to_bytes() == stored[0].trajectory_b.to_bytes()
    assert queries[0].duration_a_s == pytest.approx(1.2)
    assert queries[0].scene_hash == stored[0].scene.digest()


def test_an_empty_query_set_is_refused(database: Database, files: ArtefactStore):
    empty = QuerySet("study_room", (), {})
    with pytest.raises(ArtefactError, match="holds no queries"), database.transaction() as s:
        save_query_set(s, files, empty, name="empty", card={})


def test_a_query_set_with_a_missing_drive_is_refused(database: Database, files: ArtefactStore):
    with database.transaction() as s:
        stored = save_query_set(s, files, small_query_set(), name="mine", card={})
    with database.session() as s:
        files.delete(queries_of(s, files, stored.id)[0].trajectory_a)
        with pytest.raises(ArtefactError, match="is missing; restore a backup"):
            queries_of(s, files, stored.id)
        with pytest.raises(ArtefactError, match="is not a query set"):
            queries_of(s, files, "0" * 64)


def test_an_event_knows_its_study_and_never_holds_what_identifies(study: SmallStudy):
    _, session = study.participant("P1")
    with study.database.transaction() as s:
        event = log_event(s, "paused", session_id=session, reason="tea")
        with pytest.raises(ValueError, match="token must not be logged"):
            log_event(s, "opened", session_id=session, token="abc")
    with study.database.session() as s:
        stored = s.get(Event, event.id)
        assert (stored.study_id, stored.data) == (study.id, {"reason": "tea"})


def test_a_job_is_written_with_the_answer_that_causes_it_or_not_at_all(study: SmallStudy):
    _, session = study.participant("P1")

    def answer_and_fail() -> None:
        with study.database.transaction() as s:
            enqueue_job(s, "align", {"setup": "study_room"}, priority=1, session_id=session)
            raise RuntimeError("the answer could not be stored")

    with pytest.raises(RuntimeError):
        answer_and_fail()
    with study.database.transaction() as s:
        assert s.scalars(select(Job)).all() == []
        job = enqueue_job(s, "align", {"setup": "study_room"}, session_id=session)
        assert (job.state, job.priority) == ("queued", 10)
        assert cancel_job(s, job.id, by="tester").state == "cancelled"
        with pytest.raises(ValueError, match="has ended already: cancelled"):
            cancel_job(s, job.id, by="tester")
        with pytest.raises(LookupError, match="no job"):
            cancel_job(s, "unknown", by="tester")
        running = enqueue_job(s, "align", {})
        running.state = "running"
        assert cancel_job(s, running.id, by="tester").state == "cancelling"
    with study.database.session() as s:
        assert s.get(Session, session).state == "active"
