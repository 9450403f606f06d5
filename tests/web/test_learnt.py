"""The page on which experimenters watch what the robot learns."""

from __future__ import annotations

import csv
import io

import pytest

from desirepath.installed import PROTOCOLS
from desirepath.learning.preferences.objectives import NAMES
from desirepath.store.models import Participant
from desirepath.study.personalising.learnt import Known
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.session.joining import join_study
from desirepath.study.studies import create_study


def page_of(walked, code):
    return f"/lab/studies/{walked.id}/people/{code}/learnt"


def test_shares_after_every_answer_are_shown_and_can_be_taken_away(lab, walked):
    page = lab.get(page_of(walked, walked.half_way))
    assert page.status_code == 200
    assert page.text.count("<rect") > 9 * 7
    told = csv.DictReader(io.StringIO(lab.get(page_of(walked, walked.half_way) + ".csv").text))
    rows = list(told)
    assert tuple(told.fieldnames or ()) == ("answer", *NAMES)
    assert [row["answer"] for row in rows] == [str(n) for n in range(1, 8)], "seven regular answers, no practice"
    for row in rows:
        assert sum(float(row[name]) for name in NAMES) == pytest.approx(1, abs=1e-3)
    assert rows[0] != rows[-1]


def test_the_part_that_changes_comes_alone(lab, walked):
    part = lab.get(page_of(walked, walked.half_way), headers={"X-Fragment": "1"}).text
    assert "<html" not in part
    assert "<svg" in part


def test_what_takes_long_to_compute_keeps_no_page_waiting(lab, lab_services, walked, monkeypatch):
    monkeypatch.setattr("desirepath.study.personalising.learnt.SOON", 6)
    lab_services.files.derive(Known).clear()
    address = page_of(walked, walked.half_way)
    page = lab.get(address).text
    assert "It is being computed" in page
    assert "data-soon" in page
    assert "<rect" not in page
    assert "<rect" in lab.get(f"{address}?wait=true").text, "for who has no scripts"
    after = lab.get(address).text
    assert "<rect" in after
    assert "data-soon" not in after


def test_the_person_page_leads_there(lab, walked):
    assert page_of(walked, walked.half_way) in lab.get(f"/lab/studies/{walked.id}/people/{walked.half_way}").text


def test_before_any_answer_the_page_says_so(lab, walked):
    page = lab.get(page_of(walked, walked.fresh))
    assert page.status_code == 200
    assert "No query answered yet" in page.text
    assert lab.get(page_of(walked, walked.fresh) + ".svg").status_code == 404


def test_only_who_is_signed_in_may_watch(visitor, walked):
    assert visitor.get(page_of(walked, walked.half_way)).status_code == 303


def test_a_study_without_queries_shows_and_links_nothing_that_is_learned(lab, lab_services):
    text = (PROTOCOLS / "quick_demonstration_study.yaml").read_text().replace("pairs: 2, per_pair: 2", "pairs: 1")
    with lab_services.database.transaction() as s:
        study = create_study(s, lab_services.files, freeze_text(text), name="Drawing", created_by=None)
        session, _ = join_study(s, study, language="en", files=lab_services.files)
        code = s.get_one(Participant, session.participant_id).code
    person = f"/lab/studies/{study.id}/people/{code}"
    page = lab.get(person)
    assert page.status_code == 200
    assert "/learnt" not in page.text
    for ending in ("", ".csv", ".svg"):
        refused = lab.get(f"{person}/learnt{ending}")
        assert refused.status_code == 404
        assert "This study asks no queries" in refused.text


def test_weights_are_named_only_where_answers_are_predicted_better_than_chance(lab, lab_services, walked, monkeypatch):
    """Simulated. Seven answers that nothing predicts say nothing of a taste; nor do those of one letter."""
    address = page_of(walked, walked.half_way)
    told = "Preference weights the policy is conditioned on"
    for odds, one_sided, said in ((1.2, False, False), (80.0, False, True), (80.0, True, False)):
        lab_services.files.derive(Known).clear()
        monkeypatch.setattr("desirepath.learning.preferences.predictive_power.odds_against_chance", lambda _, o=odds: o)
        letters = ["a"] * 8 if one_sided else ["a", "b"] * 4
        monkeypatch.setattr("desirepath.study.personalising.learnt.find_letters", lambda *_, of=letters: of)
        page = lab.get(address).text
        assert (told in page) == said
        assert ("not predicted better than chance (odds 1.2 : 1; 5 : 1 are needed)" in page) == (odds < 5)
        assert ("Position bias: A in 8 of 8 (p = 0.008)" in page) == one_sided
