"""A running study gets a new protocol: who is under way keeps theirs, and everybody is told what the change means."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from desirepath.cli.main import app
from desirepath.store.database import Database
from desirepath.store.dataset.importing import import_dataset
from desirepath.store.dataset.writing import export_study
from desirepath.store.models import Artefact, Session, Study, utc_now
from desirepath.store.query_sets import query_sets_here
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.revising import differences, query_sets_for, revise_study, versions_of
from desirepath.study.session.versions import newest_protocol, protocol_of
from desirepath.study.studies import StudyError, create_study
from tests.study.small_protocol import BLOCK, CROSSED, protocol_text, small_protocol
from tests.study.walking import Walker

ABOUT = {"questionnaire": {"use": "about"}}
CONSENT = {"given": True, "version": "1"}


@pytest.fixture
def protocol(tmp_path, twenty_queries):
    """A protocol of the family; its texts lie in a folder that tests may change."""

    def made(stages=(ABOUT, BLOCK), version=1, **keys):
        return small_protocol(tmp_path, list(stages), query_set=str(twenty_queries), version=version, **keys)

    return made


@pytest.fixture
def study(database, files, protocol):
    with database.transaction() as s:
        return create_study(s, files, protocol(), name="Small", created_by=None)


def revised(database, files, study, frozen):
    with database.transaction() as s:
        return revise_study(s, files, s.get_one(Study, study.id), frozen, by="ada")


def test_who_is_under_way_keeps_the_protocol_they_began_with(database, files, study, protocol):
    before = Walker(database, files, study)
    longer = {"block": {**BLOCK["block"], "trials": [{"queries": {"count": 5}}]}}
    revised(database, files, study, protocol((ABOUT, longer), version=2))
    after = Walker(database, files, study)
    for walker, number, trials in ((before, 1, 2), (after, 2, 5)):
        walker.submit("consent", CONSENT)
        walker.submit("about", {"age": 40})
        with database.session() as s:
            session = s.get_one(Session, walker.session.id)
            assert session.protocol_number == number
            assert protocol_of(s, session).protocol.version == number
        assert sum(step["kind"] == "trial" for step in session.plan) == trials
        assert walker.view.kind == "trial"
    with database.session() as s:
        lines = versions_of(s, s.get_one(Study, study.id))
        assert newest_protocol(s, study)[0] == 2
    assert [(line.number, line.people, line.simulated) for line in lines] == [(1, 1, 0), (2, 1, 0)]
    assert lines[1].changes[0]["field"] == "stages.block.trials[0].queries.count"
    assert lines[1].created_by == "ada"


def test_a_query_set_that_was_archived_meanwhile_goes_on_in_its_own_study(database, files, study, tmp_path):
    used = study.protocol["materials"]["query_set"]
    with database.transaction() as s:
        s.get_one(Artefact, used).archived_at = utc_now()
        assert used not in query_sets_here(s), "no new study is offered it"
        there = query_sets_for(s, s.get_one(Study, study.id))
    frozen = freeze_text(protocol_text([BLOCK], version=2, query_set=used), folder=tmp_path, query_sets=there)
    assert revised(database, files, study, frozen).protocol["materials"]["query_set"] == used
    with database.transaction() as s:
        s.get_one(Artefact, used).quarantined_at = utc_now()
        assert used not in query_sets_for(s, s.get_one(Study, study.id)), "answers behind it were erased"


def test_versions_travel_with_the_data(database, files, study, protocol, tmp_path):
    revised(database, files, study, protocol((BLOCK,), version=2))
    Walker(database, files, study).submit("consent", CONSENT)
    export_study(database, files, study.id, tmp_path / "out")
    there = Database(f"sqlite:///{tmp_path / 'there.sqlite'}")
    there.migrate()
    import_dataset(there, files, tmp_path / "out")
    export_study(there, files, study.id, tmp_path / "back")
    assert (tmp_path / "out" / "checksums.sha256").read_text() == (tmp_path / "back" / "checksums.sha256").read_text()
    with there.session() as s:
        assert [line.version for line in versions_of(s, s.get_one(Study, study.id))] == [1, 2]


def sorts(before, after):
    return {change.field: change.sort for change in differences(before, after)}


def test_every_sort_of_change_is_told_with_what_it_means(protocol, tmp_path):
    before = protocol((ABOUT, CROSSED))
    assert differences(before, protocol((ABOUT, CROSSED), version=9)) == []
    assert sorts(before, protocol((ABOUT, CROSSED), minutes=40)) == {"minutes": "running"}
    assert sorts(before, protocol((ABOUT, CROSSED), participants=9)) == {"participants": "taking_in"}
    scheme = protocol((ABOUT, CROSSED), assignment={"scheme": "williams"})
    assert sorts(before, scheme) == {"assignment.scheme": "assignment"}
    assert sorts(before, protocol((CROSSED,)))["stages"] == "stages"
    two = {"block": {**CROSSED["block"], "each": CROSSED["block"]["each"][:2]}}
    assert sorts(before, protocol((ABOUT, two))) == {"stages.block.each.view": "trials", "assignment": "assignment"}
    asked = {**ABOUT, "when": {"questionnaire": "quiz", "item": "replay", "is": "no"}}
    quiz = {"comprehension": {"use": "quiz"}}
    assert sorts(protocol((quiz, ABOUT, BLOCK)), protocol((quiz, asked, BLOCK))) == {
        "stages.about.when.questionnaire": "stages",
        "stages.about.when.item": "stages",
        "stages.about.when.is": "stages",
    }
    (change,) = differences(before, scheme)
    assert "Counterbalancing starts over" in change.means
    before = protocol((ABOUT, CROSSED))
    texts = {"consent.md": "consent", "debriefing.md": "words", "questionnaires/about.yaml": "items"}
    for name in texts:
        content = (tmp_path / name).read_text().replace("Words", "Other words").replace("Age?", "Your age?")
        (tmp_path / name).write_text(content)
    text = protocol_text([ABOUT, CROSSED], query_set=before.protocol.query_set)
    assert sorts(before, freeze_text(text, folder=tmp_path)) == {f"files.{name}": sort for name, sort in texts.items()}


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"version": 1, "minutes": 20}, "version = 1: must be higher than the study's 1"),
        ({"version": 2}, "nothing to do"),
        ({"version": 2, "protocol": "other"}, "this study runs 'small'; open another study"),
    ],
)
def test_a_revision_that_makes_no_sense_is_refused(database, files, study, protocol, changed, says):
    with pytest.raises(StudyError, match=says):
        revised(database, files, study, protocol(**changed))


def test_other_words_of_consent_need_a_version_of_their_own(database, files, study, protocol, tmp_path):
    frozen = protocol(version=2)
    frozen = replace(frozen, files={**frozen.files, "consent.md": "# Consent\nOther words."})
    with pytest.raises(StudyError, match="the consent's words changed, so it needs a version of its own"):
        revised(database, files, study, frozen)


def test_the_command_line_previews_compares_and_prints_the_schema(tmp_path, protocol, twenty_queries):
    protocol()
    paths = []
    for version, stages in enumerate(([BLOCK], [CROSSED]), 1):
        paths.append(tmp_path / f"{version}.yaml")
        paths[-1].write_text(protocol_text(stages, query_set=str(twenty_queries), version=version))
    run = CliRunner().invoke
    shown = json.loads(run(app, ["studies", "preview", str(paths[1]), "--json"]).stdout)
    assert [step["kind"] for step in shown["steps"]] == ["consent", *["trial"] * 9, "debriefing"]
    told = run(app, ["studies", "diff", *map(str, paths)]).stdout
    assert "stages.block.each.view: nothing -> ['top_down', 'first_person', 'immersive']" in told
    assert "Counterbalancing starts over" in told
    assert json.loads(run(app, ["studies", "schema"]).stdout)["title"] == "Protocol"
