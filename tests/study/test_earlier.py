"""A participant's answers are read by the light of earlier ones', where the protocol says so: only of who consented,
of the same group, and never of who was erased."""

from __future__ import annotations

import pytest
from sqlalchemy import select

from desirepath.grammar.source import ProtocolError
from desirepath.store.erasure import erase_participant
from desirepath.store.models import Event, Job, Participant, Session, utc_now
from desirepath.study.personalising.alignment_jobs import earlier_snapshots
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.studies import create_study
from tests.study.walking import INSTANT, QUICK, Walker

CROWD = QUICK.with_name("crowd_study.yaml")
PURPOSE = "version: 2026-11, purposes: {training: {en: Models may learn from my answers., de: Modelle dürfen lernen.}}"


def text_of(twenty_queries, prior="earlier_participants", consent=PURPOSE):
    text = INSTANT.replace("study_room/queries_varied_200", str(twenty_queries))
    text = text.replace("choose: information", "choose: random").replace("count: 15", "count: 3")
    text = text.replace("recipe: instant,", f"recipe: instant, prior: {prior},")
    return text.replace("version: 2026-11", consent)


def answered(database, files, study, *, consents=True, group=None):
    """Somebody whose alignment has ended."""
    walker = Walker(database, files, study)
    with database.transaction() as s:
        session = s.get_one(Session, walker.session.id)
        if group is not None:
            session.assignment = {**(session.assignment or {}), "groups": {"block": group}}
    walker.walk_to("consent")
    walker.submit("consent", {"given": True, "version": "2026-11", "purposes": {"training": True}})
    walker.walk_to("train.wait")
    with database.transaction() as s:
        s.get_one(Participant, walker.session.participant_id).consents = {"training": consents}  # or taken back since
        for job in s.scalars(select(Job).where(Job.session_id == walker.session.id)):
            job.state, job.progress, job.finished_at = "succeeded", 1.0, utc_now()
    return walker


def taught_by(database, walker):
    with database.session() as s:
        return earlier_snapshots(s, s.get_one(Session, walker.session.id))


def test_answers_are_read_by_the_light_of_those_who_agreed_and_of_nobody_erased(database, files, twenty_queries):
    with database.transaction() as s:
        study = create_study(s, files, freeze_text(text_of(twenty_queries)), name="Earlier", created_by=None)
    first = answered(database, files, study)
    refused = answered(database, files, study, consents=False)
    other_group = answered(database, files, study, group="other")
    last = answered(database, files, study)
    with database.session() as s:
        jobs = {job.session_id: job for job in s.scalars(select(Job).order_by(Job.created_at))}
        events = s.scalars(select(Event).where(Event.kind == "training_started", Event.session_id == last.session.id))
        assert {(event.data["prior"], event.data["earlier"]) for event in events} == {("earlier_participants", 1)}
    assert "earlier" not in jobs[first.session.id].params
    assert jobs[last.session.id].params["earlier"] == jobs[first.session.id].params["snapshot"]
    assert taught_by(database, last) == [jobs[first.session.id].params["snapshot"]]
    own = [jobs[one.session.id].params["snapshot"] for one in (refused, other_group)]
    assert not set(own) & set(taught_by(database, last))
    erase_participant(database, files, first.session.participant_id, "tests")
    assert taught_by(database, last) == []


def test_answers_are_read_by_the_light_of_people_in_general_which_needs_no_purpose(database, files, twenty_queries):
    freeze_text(text_of(twenty_queries, prior="people_in_general", consent="version: 2026-11"))
    text = text_of(twenty_queries, prior="people_in_general")
    with database.transaction() as s:
        study = create_study(s, files, freeze_text(text), name="In general", created_by=None)
    last = answered(database, files, study)
    with database.session() as s:
        jobs = s.scalars(select(Job).where(Job.session_id == last.session.id)).all()
        assert {(job.params["prior"], "earlier" in job.params) for job in jobs} == {("people_in_general", False)}


def test_people_in_general_say_nothing_of_crowds():
    text = CROWD.read_text().replace("recipe: instant,", "recipe: instant, prior: people_in_general,")
    with pytest.raises(ProtocolError, match="raters were not asked about crowds"):
        freeze_text(text)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"consent": "version: 2026-11"}, "needs the purpose 'training'"),
        ({"prior": "everybody"}, "none"),
    ],
)
def test_a_prior_that_there_cannot_be_is_refused(twenty_queries, change, told):
    with pytest.raises(ProtocolError) as refused:
        freeze_text(text_of(twenty_queries, **change))
    assert any("prior" in problem.field and told in problem.message for problem in refused.value.problems)


def test_those_before_are_an_arm_of_their_own_where_the_protocol_says_so(database, files, twenty_queries):
    text = text_of(twenty_queries, "none").replace("recipe: instant,", "recipe: each_scene,")
    text = text.replace("arms: [base, own]", "arms: [base, population, own]")
    text = text.replace("scenes: 3, view: top_down}", "scenes: 3, view: top_down, preferred: 2}")
    with database.transaction() as s:
        study = create_study(s, files, freeze_text(text), name="In general", created_by=None)
    walkers = [answered(database, files, study) for _ in range(3)]
    with database.session() as s:
        jobs = {job.session_id: job.params for job in s.scalars(select(Job))}
    first, second, last = (jobs[walker.session.id] for walker in walkers)
    assert "people" not in first
    assert last["people"].split(",") == [second["snapshot"], first["snapshot"]]
    assert last["population"] == last["comparisons"]
    erase_participant(database, files, walkers[0].session.participant_id, "tests")
    with database.session() as s:
        kept = {job.session_id: job.params for job in s.scalars(select(Job))}
    assert kept[walkers[2].session.id]["people"] == second["snapshot"]
    assert kept[walkers[1].session.id]["people"] == "", "their own robot stays, though there is nobody before them now"
