"""Opening studies and joining them: who is let in, under which code, and who is not."""

from __future__ import annotations

import re
from dataclasses import asdict

import pytest
from sqlalchemy import select

from desirepath.installed import DATASETS
from desirepath.learning.queries.queries import QuerySet
from desirepath.store.models import Artefact, Event, Participant, RecruitingId, Session, Study, utc_now
from desirepath.store.query_sets import query_sets_here, save_query_set
from desirepath.study.protocol.freezing import freeze, freeze_text, thaw
from desirepath.study.refusals import Refused
from desirepath.study.session.joining import join_study
from desirepath.study.studies import StudyError, create_study, queries_of_study, study_by_link
from tests.study.walking import QUICK

PROLIFIC = {"platform": "prolific", "external_id": "5f3c0ffee0ddba11", "study": "x"}


def join(database, files, study, **named):
    with database.transaction() as s:
        return join_study(s, study, files=files, **{"language": "en", **named})


def test_a_study_keeps_its_own_copy_of_everything(database, files, study):
    frozen = freeze(QUICK)
    assert study.files == frozen.files
    assert study.protocol_hash == thaw(study).hash != frozen.hash  # the test's own query set is another protocol
    assert thaw(study).protocol.stages[0] == frozen.protocol.stages[0]
    assert study.protocol["materials"]["setup"] == "study_room"


def test_the_token_is_stored_as_a_hash_only(database, files, study):
    session, token = join(database, files, study)
    assert token not in str({column.name: getattr(session, column.name) for column in session.__table__.columns})
    assert len(token) >= 32


def test_people_get_a_code_by_lot_and_bots_are_counted(database, files, study):
    join(database, files, study)
    for _ in range(2):
        join(database, files, study, simulated=True, oracle={"name": "random"})
    with database.session() as s:
        people = {p.code: p for p in s.scalars(select(Participant))}
    assert sorted(people)[1:] == ["S001", "S002"]
    assert re.fullmatch(r"P-[2-9A-Z]{5}", min(people))
    assert people["S001"].oracle == {"name": "random"}


def test_two_people_see_different_queries_in_different_order(database, files, study):
    plans = [[step.get("query") for step in join(database, files, study)[0].plan] for _ in range(2)]
    assert plans[0] != plans[1]


def test_the_same_person_of_a_platform_is_let_in_once(database, files, study):
    join(database, files, study, recruiting=PROLIFIC)
    with pytest.raises(Refused) as no:
        join(database, files, study, recruiting=PROLIFIC)
    assert no.value.code == "already_joined"
    with database.session() as s:
        assert s.scalars(select(RecruitingId)).one().details == {"study": "x"}
        assert len(list(s.scalars(select(Participant)))) == 1
        logged = " ".join(str(event.data) for event in s.scalars(select(Event)))
    assert PROLIFIC["external_id"] not in logged


def test_a_closed_study_takes_nobody_in(database, files, study):
    with database.transaction() as s:
        study_by_link(s, study.recruiting_token).state = "closed"
    with pytest.raises(Refused) as no:
        join(database, files, study)
    assert no.value.code == "closed"


def test_a_full_study_takes_nobody_in_but_bots_and_drop_outs_do_not_count(database, files, twenty_queries):
    with database.transaction() as s:
        text = QUICK.read_text().replace("minutes: 15", "participants: 1")
        frozen = freeze_text(text.replace("study_room/queries_varied_200", str(twenty_queries)))
        study = create_study(s, files, frozen, name="One", created_by=None)
    join(database, files, study, simulated=True)
    session, _ = join(database, files, study)
    with pytest.raises(Refused) as no:
        join(database, files, study)
    assert no.value.code == "full"
    with database.transaction() as s:
        s.get_one(Session, session.id).expires_at = utc_now()  # and nobody has looked at it since
    join(database, files, study)


def test_an_unknown_link_is_refused(database):
    with database.session() as s, pytest.raises(Refused) as no:
        study_by_link(s, "nowhere")
    assert no.value.code == "unknown"


def test_an_unknown_language_becomes_the_first_of_the_protocol(database, files, study):
    assert join(database, files, study, language="fr")[0].language == "en"
    assert join(database, files, study, language="de")[0].language == "de"


def test_an_empty_or_small_query_set_is_refused_before_anybody_joins(database, files):
    frozen = freeze(QUICK)
    for number in (0, 15):
        stored = [asdict(query) for query in queries_of_some(database, files)[:number]]
        artefact = Artefact(
            id=f"{number:064d}", kind="query_set", name="x", setup="study_room", card={"stored_queries": stored}
        )
        with database.transaction() as s:
            s.add(artefact)
            s.flush()
            with pytest.raises(StudyError, match=f"query_set = .* has {number} queries.* needs 16"):
                create_study(s, files, frozen, name="x", created_by=None, query_set=artefact)


def test_a_query_set_made_here_is_asked_by_its_id(database, files, twenty_queries):
    twenty = QuerySet.load(twenty_queries)
    with database.transaction() as s:
        eighteen = QuerySet(twenty.setup, twenty.queries[2:], {})
        made = save_query_set(s, files, eighteen, name="18 queries, seed 3", card={}).id
        here = query_sets_here(s)
    assert here[made] == "18 queries, seed 3 (study_room, 18 queries)"
    frozen = freeze_text(QUICK.read_text().replace("study_room/queries_varied_200", made), query_sets=here)
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Own queries", created_by=None)
        assert study.protocol["materials"] == {"query_set": made, "setup": "study_room"}
        asked = {query.id for query in queries_of_study(s, files, study)}
    session, _ = join(database, files, study)
    assert {step["query"] for step in session.plan if "query" in step} <= asked
    with database.transaction() as s:
        s.get_one(Artefact, made).quarantined_at = utc_now()
    with database.transaction() as s:
        assert made not in query_sets_here(s)
        with pytest.raises(StudyError, match="quarantined"):
            create_study(s, files, frozen, name="Again", created_by=None)


def test_a_damaged_query_set_is_refused_by_its_name(database, files, tmp_path):
    path = tmp_path / "damaged.npz"
    path.write_bytes((DATASETS / "study_room" / "queries_triples_50.npz").read_bytes())
    frozen = freeze_text(QUICK.read_text().replace("study_room/queries_varied_200", str(path)))
    path.write_bytes(b"not a query set")  # after the protocol was checked
    with database.transaction() as s, pytest.raises(StudyError, match=r"damaged\.npz"):
        create_study(s, files, frozen, name="x", created_by=None)


def test_nobody_gets_a_plan_that_shows_a_file_which_is_gone(database, files, full_study):
    session, _ = join(database, files, full_study)
    shown = next(step["trajectory_a"] for step in session.plan if step.get("trajectory_a"))
    files.delete(shown)

    def forty_join() -> None:  # whoever's plan draws it
        for _ in range(40):
            join(database, files, full_study)

    with pytest.raises(StudyError, match=f"the file of trajectory {shown} is missing; restore a backup"):
        forty_join()


def queries_of_some(database, files):
    with database.session() as s:
        return queries_of_study(s, files, s.scalars(select(Study).where(Study.name == "Full")).one())
