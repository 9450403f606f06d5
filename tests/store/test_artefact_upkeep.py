"""Analysts tidy up: names, an archive, and deleting what nothing hangs on, with the reason where something does."""

from __future__ import annotations

import pytest
from sqlalchemy import select, update

from desirepath.store.artefact_upkeep import (
    archive_artefact,
    delete_artefact,
    is_offered,
    rename_artefact,
    restore_artefact,
    uses_of,
)
from desirepath.store.artefacts import ArtefactError, lineage
from desirepath.store.models import Artefact, Session, Study, Trial, utc_now
from desirepath.store.outbox import cancel_job, enqueue_job
from desirepath.store.shipped_policies import policy_artefact, register_shipped
from desirepath.store.snapshots import take_snapshot
from tests.store.small_study import SmallStudy


@pytest.fixture
def chain(study: SmallStudy) -> tuple[str, str, str]:
    """A snapshot, a reward model made from it, a policy made from that."""
    _, session = study.participant("P1")
    with study.database.transaction() as s:
        snapshot = take_snapshot(s, study.files, session_id=session).id
    model = study.model(snapshot, kind="reward_model")
    return snapshot, model, study.model(model)


def stays(study: SmallStudy, artefact_id: str) -> str:
    with pytest.raises(ArtefactError) as no, study.database.transaction() as s:
        delete_artefact(s, study.files, artefact_id)
    assert study.files.exists(artefact_id)
    return str(no.value)


def test_an_artefact_is_renamed_and_keeps_its_id_and_lineage(study: SmallStudy, chain: tuple[str, str, str]):
    _, model, policy = chain
    with study.database.transaction() as s:
        assert rename_artefact(s, policy, "  Anna's, third try ").name == "Anna's, third try"
    with study.database.session() as s:
        assert lineage(s, policy).parents[0].artefact.id == model
    for wrong in ("", "   ", "two\nlines", "x" * 161):
        with pytest.raises(ArtefactError, match="must be one line"), study.database.transaction() as s:
            rename_artefact(s, policy, wrong)


def test_an_archived_one_is_offered_no_more_and_all_that_hangs_on_it_goes_on(
    study: SmallStudy, chain: tuple[str, str, str]
):
    snapshot, model, policy = chain
    with study.database.transaction() as s:
        archived = archive_artefact(s, model, by="ada", now=utc_now())
        first = archived.archived_at
        assert archive_artefact(s, model, by="bob", now=utc_now()).archived_at == first
    with study.database.session() as s:
        assert s.get_one(Artefact, model).archived_by == "ada"
        assert set(s.scalars(select(Artefact.id).where(is_offered()))) == {snapshot, policy}
        assert lineage(s, policy).all_answers() == lineage(s, snapshot).all_answers()
    with study.database.transaction() as s:
        restore_artefact(s, model)
        assert model in set(s.scalars(select(Artefact.id).where(is_offered())))


def test_what_something_was_made_from_stays_until_that_is_gone(study: SmallStudy, chain: tuple[str, str, str]):
    snapshot, model, policy = chain
    with study.database.session() as s:
        assert [one.id for one in uses_of(s, model).made] == [policy]
    assert f"1 were made from it: policy of {model[:6]}" in stays(study, model)
    for one in (policy, model, snapshot):
        with study.database.transaction() as s:
            assert delete_artefact(s, study.files, one).id == one
        assert not study.files.exists(one)
    with study.database.session() as s:
        assert s.scalars(select(Artefact)).all() == []
    with pytest.raises(ArtefactError, match="no artefact"), study.database.transaction() as s:
        delete_artefact(s, study.files, policy)


def test_answers_that_a_job_learned_from_stay_so_that_an_erasure_finds_what_was_learned(
    study: SmallStudy, chain: tuple[str, str, str]
):
    snapshot, model, policy = chain
    with study.database.transaction() as s:
        job = enqueue_job(s, "align", {"snapshot": snapshot})
        job.state = "succeeded"
        name = job.id
    for one in (policy, model):
        with study.database.transaction() as s:
            delete_artefact(s, study.files, one)
    assert f"jobs stand on it: {name}" in stays(study, snapshot)


def test_a_policy_that_was_made_for_a_participant_stays(study: SmallStudy, chain: tuple[str, str, str]):
    _, _, policy = chain
    with study.database.transaction() as s:
        session = s.scalars(select(Session)).first()
        assert session is not None
        job = enqueue_job(s, "align", {}, session_id=session.id)
        job.state = "succeeded"
        s.get_one(Artefact, policy).job_id = job.id
        name = job.id
    assert f"jobs stand on it: {name}" in stays(study, policy)


def test_what_a_study_a_job_or_a_participant_needs_stays(study: SmallStudy, chain: tuple[str, str, str]):
    _, _, policy = chain
    with study.database.transaction() as s:
        job = enqueue_job(s, "evaluate", {"policy": policy}).id
        row = s.get_one(Study, study.id)
        row.protocol = {**row.protocol, "materials": {"query_set": policy}}
        s.execute(update(Trial).where(Trial.step_key == "trial-1").values(arms={"a": policy, "b": "dwa", "own": "a"}))
    told = stays(study, policy)
    assert "studies ask from it: Passing people" in told
    assert f"jobs stand on it: {job}" in told
    assert "participants were shown it in 1 trials" in told
    with study.database.transaction() as s:
        cancel_job(s, job, by="ada")
        assert uses_of(s, policy).jobs == ()


def test_what_came_with_the_product_stays(study: SmallStudy):
    with study.database.transaction() as s:
        register_shipped(s, study.files)
        base = policy_artefact(s, "study_room/base").id
    assert "it came with the product" in stays(study, base)
