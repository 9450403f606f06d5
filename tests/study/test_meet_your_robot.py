"""After everything blind people are told what was learned, meet their robot, correct it; nothing blind hears of it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import pytest
import yaml
from sqlalchemy import select

from desirepath.grammar.source import ProtocolError
from desirepath.learning.measures.named import NAMED
from desirepath.learning.policies.reason_codes import Did
from desirepath.learning.preferences.objectives import NAMES, names_of
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import analyse
from desirepath.report.meeting import meeting_section, summarise_meetings
from desirepath.report.study_data import Meeting
from desirepath.report.tidy_tables import read_study
from desirepath.simulation.setups import setups_with
from desirepath.store.models import Artefact, Job, Session, Study, Trial, utc_now
from desirepath.store.snapshots import take_snapshot
from desirepath.study.kind import Moment, kind_of
from desirepath.study.kinds.live import crowd_setups, distance, objectives_on, startable
from desirepath.study.kinds.meet_your_robot import MeetYourRobotStage, MeetYourRobotStep
from desirepath.study.kinds.wait import TrainStage
from desirepath.study.personalising import believed, next_query
from desirepath.study.personalising.believed import beyond_nine
from desirepath.study.personalising.live_rollouts import condition_on, looks_at, roll_out, scenes_of
from desirepath.study.protocol.freezing import find_shipped_protocols, freeze
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.study.session.versions import protocol_of
from desirepath.study.studies import queries_of_study
from desirepath.web.core.catalogues import Texts
from tests.study.small_protocol import BLOCK, COME_BACK, small_protocol
from tests.study.walking import answer

LOCALES = Path(__file__).resolve().parents[2] / "frontend" / "locales"
TRAIN = {"train": {"job": "align", "recipe": "instant"}}
COMPARISON = {"comparison": {"arms": ["base", "own"], "scenes": 1, "guess": False}}
MEET = {"meet_your_robot": {"scenes": 2}}
LEARN = {"block": {"view": "top_down", "trials": [{"queries": {"count": 3}}]}}
UNSURE = {"passed": False, "why": "not_surely_better", "personal": {"passed": False, "probability_better": 0.6}}


@pytest.fixture
def taught(walk):
    """A session whose three answers are given, which waits for its two alignments."""
    walker = walk(LEARN, TRAIN, COMPARISON, MEET)
    for _ in range(3):
        key = walker.view.key
        walker.watch(key)
        walker.submit(key, {"choice": "a"})
    return walker


def learned(walker, **result) -> None:
    """What the worker writes when the alignments have ended, and the session goes on."""
    with walker.database.transaction() as s:
        study = s.get_one(Study, walker.session.study_id)
        query = queries_of_study(s, walker.files, study)[0]
        pair = {"base": query.trajectory_a, "own": query.trajectory_b, "look_alike": False}
        for job in s.scalars(select(Job)):
            job.state, job.progress = "succeeded", 1.0
            job.result = {"policy": "none such", "passed": True, "comparisons": [pair], **result}

    def settle(s, session) -> object:
        return machine.settle(s, walker.files, session, now=walker.now)

    assert walker.do(settle)


def met(walker) -> None:
    """Past the blind comparison, to the robot."""
    key = walker.view.key
    walker.watch(key)
    walker.submit(key, {"choice": "b"})
    assert walker.view.kind == "meet_your_robot"


def test_people_are_told_what_was_learned_and_how_sure_it_is(taught, monkeypatch):
    monkeypatch.setattr(believed, "SAID_FROM", 0.1)  # three answers say little
    learned(taught, check=PREDICTED)
    met(taught)
    payload = taught.view.payload
    told = payload["believed"]
    assert payload["start"] == told["weights"]
    assert (told["answers"], told["statement"]) == (3, "rather")
    assert told["foremost"] != told["rather_than"]
    with taught.database.session() as s:
        posterior = next_query.posterior_of(s, taught.files, s.get_one(Session, taught.session.id))
    first, second = (NAMES.index(told[name]) for name in ("foremost", "rather_than"))
    more = posterior.masses()[posterior.weights[:, first] > posterior.weights[:, second]].sum()
    assert told["rather_sure"] == pytest.approx(0.9 * more, abs=1e-3), "that the nine describe them, and the order"
    taught.submit("meet_your_robot", {"agreement": 4, "weights": payload["start"]})
    value = answer(taught, "meet_your_robot").value
    assert (value["statement"], value["sure"]) == ("rather", told["rather_sure"])


PREDICTED = {"better_than_chance": True, "something_else": 0.1, "words": {}, "agreeing": {}, "answers": 15}
CHECK = {
    **PREDICTED,
    "something_else": 0.83,
    "words": {"turning_on_the_spot": -1.0, "free_range_ahead": 0.7, "jerk": -0.2},
    "agreeing": {"turning_on_the_spot": 12, "free_range_ahead": 8, "jerk": 10},
}


@pytest.mark.parametrize(
    "check", [None, {**PREDICTED, "better_than_chance": False}, {**CHECK, "better_than_chance": False}]
)
def test_nothing_is_said_of_a_taste_that_is_not_predicted_better_than_chance(taught, check, monkeypatch):
    monkeypatch.setattr(believed, "SAID_FROM", 0.0)
    learned(taught, **({"check": check} if check else {}))
    met(taught)
    assert taught.view.payload["believed"]["statement"] is None
    taught.submit("meet_your_robot", {"agreement": 4, "weights": taught.view.payload["start"]})
    value = answer(taught, "meet_your_robot").value
    assert (value["statement"], value["sure"], value["something_else"]) == (None, None, None)


def test_what_is_little_more_probable_than_its_opposite_is_no_sentence(taught):
    learned(taught, check=PREDICTED | {"something_else": 0.3})
    met(taught)
    assert taught.view.payload["believed"]["rather_sure"] < believed.SAID_FROM
    assert taught.view.payload["believed"]["statement"] is None


def test_who_was_shown_a_free_form_robot_is_told_of_something_else_and_where_it_shows(taught):
    learned(taught, free_form=True, check=CHECK)
    met(taught)
    assert taught.view.payload["believed"]["statement"] == "beyond"
    beyond = taught.view.payload["believed"]["beyond"]
    assert (beyond["sure"], beyond["answers"]) == (0.83, 15)
    in_words = [list(one) for one in beyond["words"]]
    assert in_words == [["turning_on_the_spot", "less", 12], ["jerk", "less", 10]], "not what 8 of 15 answers show"
    taught.submit("meet_your_robot", {"agreement": 4, "weights": taught.view.payload["start"]})
    assert answer(taught, "meet_your_robot").value["something_else"] == 0.83


@pytest.mark.parametrize(
    ("check", "shown", "told"),
    [
        (CHECK, {}, True),
        ({**CHECK, "something_else": 0.3}, {}, False),
        ({**CHECK, "something_else": 0.3}, {"free_form": True}, True),
        ({}, {"free_form": True}, False),
    ],
)
def test_something_else_is_told_where_it_is_more_probable_or_was_shown(check, shown, told):
    assert (beyond_nine(check, shown) is not None) == told


@pytest.mark.parametrize("protocol", find_shipped_protocols(), ids=lambda path: path.stem)
def test_every_shipped_protocol_that_teaches_a_robot_by_choices_ends_with_meeting_it(protocol: Path):
    frozen = freeze(protocol).protocol
    kinds = [entry.kind for entry in frozen.stages]
    learning = frozen.stage_of(TrainStage)
    if learning is None or learning.job != "align":
        assert "meet_your_robot" not in kinds
        return
    assert kinds.index("comparison") < kinds.index("meet_your_robot") == len(kinds) - 2, "then the debriefing"
    met = frozen.stage_of(MeetYourRobotStage)
    assert met is not None
    assert str(frozen.query_set).startswith(f"{met.setup}/"), "in the places that the answers were about"


@pytest.mark.parametrize("language", ["en", "de"])
@pytest.mark.parametrize("setup", setups_with("conditioned"))
def test_every_objective_that_may_be_told_has_plain_words_of_where_it_is(setup, language):
    words = yaml.safe_load(Path(f"frontend/locales/{language}/live.yaml").read_text())
    for name in names_of(setup):
        needed = {"name", "rather", "does", "does_more"} if name in objectives_on(setup) else {"rather"}
        assert set(words["weights"].get(name, {})) == needed
        if setup in crowd_setups():
            spoken = words["among_people"].get(name, words["weights"][name])
            assert not re.search(r"\b(you|me|Sie|Ihnen|mir|mich)\b", " ".join(spoken.values())), name


@pytest.mark.parametrize("language", ["en", "de"])
def test_among_people_no_measure_is_said_to_be_about_the_participant_alone(language):
    words = yaml.safe_load(Path(f"frontend/locales/{language}/live.yaml").read_text())
    mine = r"\b(you|Sie|Ihnen|Ihrer)\b"
    personal = {name for name, said in words["seen"].items() if re.search(mine, said)}
    assert personal == set(words["seen_among_people"])
    assert not re.search(mine, " ".join(words["seen_among_people"].values()))


def test_the_sliders_begin_with_what_they_can_say_of_what_was_learned():
    step = MeetYourRobotStep(
        kind="meet_your_robot", key="meet", stage="meet", setup="crowd_hall", scenes=1, view="top_down"
    )
    learned = {"cuts_in_front": 0.4, "follows": 1.0, "waits": 0.7, "farther": 0.2}
    assert startable(step, learned) == {"waits": 0.7, "farther": 0.2}
    assert startable(step.model_copy(update={"setup": "study_room"}), {"farther": 0.2}) == {"farther": 0.2}


def test_reasons_are_not_told_where_more_than_one_person_is(tmp_path):
    meeting = {"meet_your_robot": {"setup": "crowd_hall", "reasons": True}}
    with pytest.raises(ProtocolError, match=r"reasons.*more than one person"):
        small_protocol(tmp_path, [BLOCK, TRAIN, COMPARISON, meeting])


@pytest.mark.parametrize("language", ["en", "de"])
def test_every_measure_that_may_be_told_has_plain_words(language):
    words = yaml.safe_load(Path(f"frontend/locales/{language}/live.yaml").read_text())["seen"]
    assert sorted(words) == sorted(NAMED)


def test_agreement_correction_and_the_distance_between_are_the_answer(taught):
    learned(taught)
    met(taught)
    start = taught.view.payload["start"]
    one = next(iter(start))
    history = [{"seconds": 2.5, "place": 1, "by": "keys", "objective": one, "weight": 0.1}]
    taught.submit("meet_your_robot", {"agreement": 2, "weights": {**start, one: 0.1}, "history": history})
    value = answer(taught, "meet_your_robot").value
    assert (value["agreement"], value["corrected"]) == (2, True)
    assert value["learned"] == start
    assert value["distance"] == pytest.approx(distance(start, {**start, one: 0.1}))
    assert taught.view.kind == "debriefing"


def test_who_keeps_their_robot_corrected_nothing(taught):
    learned(taught)
    met(taught)
    with pytest.raises(Refused, match="from 1 to 5"):
        taught.submit("meet_your_robot", {"agreement": 6, "weights": {}})
    told = [{"place": 0, "did": ["as_usual"]}, {"place": 1, "did": ["behind", "farther"]}]
    taught.submit("meet_your_robot", {"agreement": 5, "weights": taught.view.payload["start"], "why": told})
    value = answer(taught, "meet_your_robot").value
    assert (value["corrected"], value["distance"], value["why"]) == (False, 0.0, told)


def test_every_reason_has_words_in_both_languages():
    texts = Texts(LOCALES)
    for language in ("en", "de"):
        assert set(texts.get(language).table("live.script")["why"]) == {*get_args(Did), "here"}


def test_nobody_is_shown_a_robot_as_theirs_that_is_not_surely_better(taught):
    learned(taught, **UNSURE)
    view = taught.view
    assert (view.kind, view.payload["about"]["outcome"]) == ("debriefing", "not_surely_better"), "no empty step"


@pytest.mark.parametrize(("own_chosen", "then"), [(True, "meet_your_robot"), (False, "debriefing")])
def test_who_must_have_preferred_their_robot_meets_it_only_then(walk, own_chosen, then):
    train = {"train": {"job": "align", "recipe": "each_scene"}}
    walker = walk(LEARN, train, COMPARISON, {"meet_your_robot": {"scenes": 2, "preferred": 1}})
    for _ in range(3):
        key = walker.view.key
        walker.watch(key)
        walker.submit(key, {"choice": "a"})
    learned(walker)
    with walker.database.session() as s:
        arms = s.scalars(select(Trial).where(Trial.kind == "comparison")).one().arms
    key = walker.view.key
    walker.watch(key)
    own = arms["own"]
    walker.submit(key, {"choice": own if own_chosen else "ab".replace(own, "")})
    assert walker.view.kind == then
    if then == "debriefing":
        about = walker.view.payload["about"]
        assert (about["outcome"], about["compared"]) == ("shown", [{"against": "base", "own": 0, "pairs": 1}])


def test_nobody_meets_a_robot_that_went_with_somebody_who_was_erased(taught):
    with taught.database.session() as s:
        policy = s.scalars(select(Artefact.id)).first()
    learned(taught, policy=policy)
    with taught.database.transaction() as s:
        s.get_one(Artefact, policy).quarantined_at = utc_now()
    key = taught.view.key
    taught.watch(key)
    taught.submit(key, {"choice": "b"})
    assert taught.view.kind == "debriefing"


def test_who_is_at_it_already_goes_on_by_what_their_own_answers_taught(taught):
    with taught.database.session() as s:
        policy = s.scalars(select(Artefact.id)).first()
    learned(taught, policy=policy)
    met(taught)
    with taught.database.transaction() as s:
        s.get_one(Artefact, policy).quarantined_at = utc_now()
    with taught.database.session() as s:
        session = s.get_one(Session, taught.session.id)
        moment = Moment(s, session, protocol_of(s, session), utc_now())
        own, usual = kind_of(moment.step).policies(moment.step, moment, taught.files, None)
    assert own.digest() == condition_on(moment.step.setup, taught.view.payload["start"]).digest() != usual.digest()


def test_what_those_before_want_is_an_arm_of_the_comparison_and_of_the_report(walk, files):
    consent = {"consent": {"text": "consent.md", "version": "1", "purposes": {"training": {"en": "Learn from it?"}}}}
    given = {"given": True, "version": "1", "purposes": {"training": True}}
    train = {"train": {"job": "align", "recipe": "each_scene"}}
    arms = {"comparison": {"arms": ["base", "population", "own"], "scenes": 1, "guess": False}}
    walker = walk(LEARN, train, arms, consent_stage=consent, consent=given)
    for _ in range(3):
        key = walker.view.key
        walker.watch(key)
        walker.submit(key, {"choice": "a"})
    with walker.database.session() as s:
        query = queries_of_study(s, walker.files, s.get_one(Study, walker.session.study_id))[0]
    pair = {"population": query.trajectory_a, "own": query.trajectory_b}
    learned(walker, population=[pair], in_general={"people": 7, "passed": True})
    for _ in range(2):
        with walker.database.session() as s:
            arms = s.scalars(select(Trial).where(Trial.step_key == walker.view.key)).one().arms
        key = walker.view.key
        walker.watch(key)
        walker.submit(key, {"choice": arms["own"]})
    compared = walker.view.payload["about"]["compared"]
    assert sorted((of["against"], of["own"]) for of in compared) == [("base", 1), ("population", 1)]
    with walker.database.session() as s:
        data, load = read_study(s, files, s.get_one(Study, walker.session.study_id))
    assert {(of.chosen, of.rejected) for of in data.comparisons} == {("own", "base"), ("own", "population")}
    found = analyse(data, load, "people", AnalysisPlan(sessions="all"), intervals=False)
    assert [(of.against, of.earlier) for of in found.personalised] == [("base", ()), ("population", (7,))]


@pytest.mark.parametrize(
    ("train", "comparison", "meet", "told"),
    [
        ({"prior": "earlier_participants"}, {}, {}, "needs the purpose 'training'"),
        ({"ask_on": {"at_most": 2, "each": 2}}, {}, {}, "whose comparison decides"),
        ({}, {"arms": ["own", "other"]}, {}, "needs a comparison with base"),
        ({}, {"arms": ["base", "population", "own"]}, {}, "needs the purpose 'training'"),
        ({"recipe": "instant"}, {"arms": ["base", "population", "own"]}, {}, "population needs recipe each_scene"),
        ({}, {}, {"preferred": None}, "needs `preferred` of meet_your_robot"),
        ({}, {"scenes": 2}, {"preferred": 3}, "at most the comparison's scenes with base, 2"),
    ],
)
def test_what_cannot_stand_beside_a_choice_per_scene_is_refused(tmp_path, train, comparison, meet, told):
    stages = [
        LEARN,
        {"train": {"job": "align", "recipe": "each_scene", **train}},
        {"comparison": {"arms": ["base", "own"], "scenes": 1, **comparison}},
        {"meet_your_robot": {"scenes": 2, "preferred": 1, **meet}},
    ]
    with pytest.raises(ProtocolError, match=told):
        small_protocol(tmp_path, stages)


def test_a_choice_per_scene_needs_policies_to_choose_from(tmp_path):
    train = {"train": {"job": "align", "recipe": "each_scene"}}
    with pytest.raises(ProtocolError, match=r"setup with a policy library: .*study_room"):
        small_protocol(tmp_path, [LEARN, train, COMPARISON], query_set="crowd_hall/queries_varied_200")


def test_nothing_of_it_reaches_the_blind_data(taught, files):
    learned(taught)
    met(taught)
    database = taught.database

    def blind() -> tuple:
        with database.transaction() as s:
            study = s.get_one(Study, taught.session.study_id)
            snapshot = take_snapshot(s, files, session_id=taught.session.id).id
            data, _ = read_study(s, files, study)
            return snapshot, data.choices, data.ratings, data.comparisons, data.guesses

    before = blind()
    start = taught.view.payload["start"]
    history = [{"seconds": 1, "place": 0, "by": "mouse", "objective": "faster", "weight": 0.7}]
    taught.submit("meet_your_robot", {"agreement": 1, "weights": {**start, "faster": 0.7}, "history": history})
    assert blind() == before


def test_the_report_shows_agreement_and_correction_beside_everything_tested(taught, files):
    learned(taught)
    met(taught)
    start = taught.view.payload["start"]
    history = [{"seconds": 1, "place": 0, "by": "mouse", "objective": "faster", "weight": 0.7}]
    taught.submit("meet_your_robot", {"agreement": 4, "weights": {**start, "faster": 0.7}, "history": history})
    with taught.database.session() as s:
        data, load = read_study(s, files, s.get_one(Study, taught.session.study_id))
    found = analyse(data, load, "people", AnalysisPlan(sessions="all"), intervals=False)
    assert (found.met.shown, found.met.agreement.mean, found.met.corrected.mean) == (1, 4, 1)
    section = meeting_section(found.met)
    assert section.sentences[0].startswith("After everything blind, 1 people met")
    assert [row[1] for row in section.tables[0].rows][:2] == ["4.00", "1.00"]


def test_intervals_stand_beside_what_people_said():
    people = [Meeting(f"S{k}", 3 + k % 3, k % 2 == 0, 0.4 * (k % 2 == 0)) for k in range(12)]
    found = summarise_meetings(people)
    assert found.agreement.low < 4 < found.agreement.high
    assert 0 <= found.corrected.low < 0.5 < found.corrected.high <= 1
    assert found.distance.mean == pytest.approx(0.2)
    assert (found.moved.n, found.moved.mean) == (6, pytest.approx(0.4))
    assert summarise_meetings([]) is None


@pytest.mark.parametrize(
    ("stages", "said"),
    [
        ([LEARN, MEET], "needs the comparison before it"),
        ([LEARN, TRAIN, COMPARISON, MEET, BLOCK], "stands before something blind"),
        ([LEARN, TRAIN, COMPARISON, COME_BACK, MEET], "comparison's appointment"),
        ([LEARN, TRAIN, COMPARISON, {"meet_your_robot": {"setup": "open_field"}}], "must be study_room"),
    ],
)
def test_a_protocol_that_shows_it_before_all_is_blindly_measured_is_refused(tmp_path, stages, said):
    with pytest.raises(ProtocolError, match=said):
        small_protocol(tmp_path, stages)


def test_who_taught_nothing_is_passed_over(walk):
    walker = walk({"block": {"view": "top_down", "trials": [{"queries": {"count": 1}}]}}, TRAIN, COMPARISON, MEET)
    key = walker.view.key
    walker.watch(key)
    walker.submit(key, {"choice": "a"})
    assert walker.view.kind == "debriefing"


def test_where_the_protocol_asks_for_it_what_a_robot_turns_for_is_told_by_things_that_pages_can_name(walk):
    said = {"meet_your_robot": {"scenes": 2, "reasons": True}}
    planned = walk(LEARN, TRAIN, COMPARISON, said).session.plan[-2]
    assert (planned["kind"], planned["reasons"]) == ("meet_your_robot", True)
    texts = Texts(LOCALES)
    for setup in ("study_room", "open_field"):
        policy, scene = condition_on(setup, {"farther": 1.0}), scenes_of(setup)[0]
        named = looks_at(policy, roll_out(policy, scene))
        assert 0 < len(named) <= 2
        assert all(texts.get(language).knows(f"explanation.things.{one}") for one in named for language in ("en", "de"))
