"""Many join in the same moment: written together, and each as if alone."""

from __future__ import annotations

import asyncio
from collections import Counter

import pytest
from sqlalchemy import event, select

from desirepath.store.models import Event, Participant, RecruitingId, Session, Study
from desirepath.study.refusals import Refused
from desirepath.study.session.joining import Joiner, TakenIn
from desirepath.study.studies import create_study
from tests.study.small_protocol import CROSSED, small_protocol
from tests.study.walking import twenty_queries

PERSON = Joiner("en")
BOT = Joiner("en", simulated=True)


@pytest.fixture
def crowded(services, tmp_path):
    """The link of a study that takes in four people, in three orders of conditions."""
    keys = {
        "query_set": str(twenty_queries(tmp_path)),
        "assignment": {"scheme": "latin_square", "seed": 1},
        "participants": 4,
    }
    with services.database.transaction() as s:
        frozen = small_protocol(tmp_path, [CROSSED], **keys)
        return create_study(s, services.files, frozen, name="Crowded", created_by=None).recruiting_token


def at_once(services, link, people):
    """What becomes of everybody who knocks while somebody else is writing, in their order."""

    async def knock():
        with services.database.transaction():
            asked = [asyncio.create_task(services.doors.join(link, who)) for who in people]
            await asyncio.sleep(0)  # all of them stand in line
        return await asyncio.gather(*asked, return_exceptions=True)

    return asyncio.run(knock())


def named(platform_id):
    return Joiner("en", recruiting={"platform": "prolific", "external_id": platform_id})


def test_nobody_too_many_gets_in_and_the_orders_stay_balanced(services, crowded):
    done = at_once(services, crowded, [PERSON, BOT, PERSON, BOT, PERSON, BOT, PERSON, PERSON, PERSON])
    assert [isinstance(one, TakenIn) for one in done] == [True] * 7 + [False, False]
    assert {one.code for one in done if isinstance(one, Refused)} == {"full"}
    with services.database.session() as s:
        people = dict(s.execute(select(Session.id, Session.simulated)).all())
        rows = Counter((one.simulated, one.assignment["row"]) for one in s.scalars(select(Session)))
        codes = list(s.scalars(select(Participant.code)))
        told = Counter(s.scalars(select(Event.kind).where(Event.session_id.in_(people))))
    assert sorted(code for code in codes if code.startswith("S")) == ["S001", "S002", "S003"]
    assert len(set(codes)) == len(people) == 7
    assert sorted(rows[False, row] for row in range(3)) == [1, 1, 2]
    assert [rows[True, row] for row in range(3)] == [1, 1, 1]
    assert told == {"joined": 7, "step_entered": 7}


def test_one_commit_is_for_all_who_wait(services, crowded):
    commits = []
    event.listen(services.database.engine, "commit", commits.append)
    assert all(isinstance(one, TakenIn) for one in at_once(services, crowded, [BOT] * 12))
    assert len(commits) <= 2, "one for who knocked first, one for the eleven who waited meanwhile"


def test_the_same_person_of_a_platform_is_let_in_once_among_those_who_wait(services, crowded):
    done = at_once(services, crowded, [PERSON, named("a"), named("b"), named("a")])
    assert [getattr(one, "code", "in") for one in done] == ["in", "in", "in", "already_joined"]
    with services.database.session() as s:
        assert sorted(s.scalars(select(RecruitingId.external_id))) == ["a", "b"]
        assert len(list(s.scalars(select(Participant.id)))) == 3


def test_what_cannot_be_stored_is_refused_to_who_brought_it_alone(services, crowded):
    broken = Joiner("en", simulated=True, oracle={"name": object()})
    done = at_once(services, crowded, [BOT, BOT, broken, BOT])
    assert [isinstance(one, TakenIn) for one in done] == [True, True, False, True]
    with services.database.session() as s:
        stored = {one.id: one.participant_id for one in s.scalars(select(Session))}
    assert set(stored) == {one.session.id for one in done if isinstance(one, TakenIn)}


def test_a_link_that_leads_nowhere_is_refused_to_everybody(services, crowded):
    assert {one.code for one in at_once(services, "nowhere", [PERSON, BOT])} == {"unknown"}
    with services.database.transaction() as s:
        s.scalars(select(Study).where(Study.recruiting_token == crowded)).one().state = "closed"
    assert {one.code for one in at_once(services, crowded, [PERSON, BOT, PERSON])} == {"closed"}
