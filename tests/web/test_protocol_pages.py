"""The lab shows every kind of stage in words, previews each of its steps, and tells versions of a protocol apart."""

from __future__ import annotations

import html
import re
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from desirepath.installed import PROTOCOLS
from desirepath.store.models import Study
from desirepath.study.revising import revise_study
from desirepath.study.session.versions import newest_protocol
from desirepath.study.studies import create_study
from desirepath.web.core.dependencies import Services
from desirepath.web.lab.preview import preview_steps
from tests.study.small_protocol import CROSSED, DEBRIEFING, small_protocol
from tests.study.walking import twenty_queries
from tests.web.lab_services import csrf

ABOUT = {"questionnaire": {"use": "about", "time_limit_s": 60}}
RATING = {"questionnaire": {"use": "rating"}, "when": {"questionnaire": "about", "item": "age", "at_least": 30}}
SAID = {"answers": {"no_difference": True, "degree": "strength"}}
EVERYTHING = [
    ABOUT,
    {"comprehension": {"use": "quiz", "text": "instruction.md"}},
    {"block": {**CROSSED["block"], "attention_checks": 1, "viewing": {"replays": 1, "choice_limit_s": 20}, **SAID}},
    {"break": {"text": "pause.md", "at_least_s": 20}},
    {"appointment": {"text": "come_back.md"}},
    {"instruction": {"text": "instruction.md"}},
    RATING,
    {"questionnaire": {"use": "order"}},
]


@pytest.fixture
def study(lab_services: Services, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Study:
    monkeypatch.setitem(DEBRIEFING["debriefing"], "return_url", "https://example.org/?cc=BACK-88")
    folder = tmp_path / "protocols"
    folder.mkdir()
    keys = {"query_set": str(twenty_queries(folder)), "assignment": {"scheme": "latin_square"}}
    keys["screen_out"] = {"text": "sorry.md", "completion_code": "SORRY-77"}
    with lab_services.database.transaction() as s:
        study = create_study(
            s, lab_services.files, small_protocol(folder, EVERYTHING, **keys), name="Everything", created_by=None
        )
        revise_study(s, lab_services.files, study, small_protocol(folder, EVERYTHING[:-1], version=2, **keys), by="ada")
    return study


def test_every_stage_is_told_in_words_and_versions_stand_apart(lab: TestClient, study: Study):
    newest = lab.get(f"/lab/studies/{study.id}/protocol").text
    first = lab.get(f"/lab/studies/{study.id}/protocol?number=1").text
    for page in (newest, first):
        assert "Versions of the protocol" in page
        assert "New participants go through different stages" in page
        assert "Comprehension check" in page
        assert "View: from above, first person, immersive" in page
        assert re.findall(r"May also be answered</dt>\s*<dd>([^<]*)", page) == [
            "no difference",
            "how much better: a little, clearly",
        ]
        assert "lab.protocol." not in page
    assert ">order</span>" in first
    assert ">order</span>" not in newest
    assert "version: 1" in lab.get(f"/lab/studies/{study.id}/protocol.yaml?number=1").text
    assert "version: 2" in lab.get(f"/lab/studies/{study.id}/protocol.yaml").text


def test_every_step_of_a_protocol_can_be_previewed(lab: TestClient, lab_services: Services, study: Study):
    with lab_services.database.session() as s:
        steps = preview_steps(newest_protocol(s, s.get_one(Study, study.id))[1])
    assert {"attention", "comprehension", "break", "appointment", "trial"} <= {step.kind for step in steps}
    for number, step in enumerate(steps, 1):
        answered = lab.get(f"/lab/studies/{study.id}/preview/{number}")
        assert answered.status_code == 200, (step.kind, answered.text[:500])


def test_a_running_study_is_changed_here_and_what_it_means_is_said_before(lab: TestClient, study: Study):
    here = f"/lab/studies/{study.id}"
    assert f"{here}/revise" in lab.get(f"{here}/protocol").text
    form = {"csrf": csrf(lab)}
    assert "sorry.md" in lab.get(f"{here}/revise").text
    texts = {"texts": ("pause.md", b"# Rest\n\nRest for longer.", "text/markdown")}
    made = lab.post(f"{here}/revise", data=form, files=texts)
    draft = made.headers["location"]
    page = lab.get(draft).text
    assert "files.pause.md" in page  # the version was raised, the text replaced where the study keeps it
    assert "New participants read a different wording" in page
    assert "Create version 3" in page
    assert lab.get(f"{draft}/preview/1").status_code == 200
    yaml = lab.get(f"{here}/protocol.yaml").text
    same = lab.post(draft, data={**form, "yaml": yaml})
    assert (same.status_code, "must be higher" in lab.get(draft).text) == (303, True)
    lab.post(draft, data={**form, "yaml": yaml.replace("version: 2", "version: 3") + "hours: 3\n"})
    assert "hours" in lab.get(draft).text
    assert "Create version 3" not in lab.get(draft).text
    lab.post(draft, data={**form, "yaml": yaml.replace("version: 2", "version: 3")})
    done = lab.post(f"{draft}/open", data=form)
    assert done.headers["location"] == f"{here}/protocol?done=study_revised"
    told = lab.get(done.headers["location"]).text
    assert "The new version is saved" in told
    assert "files.pause.md" in told
    assert lab.get(draft).status_code == 404


def test_what_is_worth_money_is_shown_to_who_may_take_it(lab: TestClient, as_role, study: Study):
    page = f"/lab/studies/{study.id}/protocol"
    assert "SORRY-77" in lab.get(page).text
    seen = as_role("viewer").get(page).text
    assert "SORRY-77" not in seen
    assert "completion_code: &#34;•••&#34;" in seen


def test_nor_does_the_preview_of_the_last_page_tell_the_way_back(
    lab: TestClient, lab_services: Services, as_role, study: Study
):
    with lab_services.database.session() as s:
        last = len(preview_steps(newest_protocol(s, s.get_one(Study, study.id))[1]))
    page = f"/lab/studies/{study.id}/preview/{last}"
    assert "cc=BACK-88" in lab.get(page).text
    viewer = as_role("viewer")
    assert "https://removed.invalid/" in viewer.get(page).text
    assert not any("BACK-88" in viewer.get(shown).text for shown in (page, f"/lab/studies/{study.id}/protocol"))


NEUTRAL = "Own against the conditioned policy without preferences"


def test_check_it_says_what_the_own_policy_is_compared_with(lab: TestClient):
    for shipped, told in (
        ("personalisation_study", ("Own against base policy", NEUTRAL, "Own against another participant’s policy")),
        ("quick_preference_study", ("Own against base policy",)),
        ("quick_demonstration_study", ("Own against dynamic window approach",)),
    ):
        made = lab.post("/lab/new", data={"csrf": csrf(lab, "/lab/new"), "source": f"shipped:{shipped}"})
        page = html.unescape(lab.get(made.headers["location"]).text)
        assert tuple(re.findall(r"<dt>(Own against [^<]+)</dt>", page)) == told
        assert ("own policy: signed ranks" in page) == (shipped == "personalisation_study"), "of the analysis plan"
        assert ("a simulated person’s policy is used" in page) == (len(told) == 3)


def test_the_protocol_page_tells_the_prior_and_the_motors_where_they_are_asked_for(lab: TestClient):
    shipped = (PROTOCOLS / "quick_preference_study.yaml").read_text()
    asked = shipped.replace("recipe: each_scene,", "recipe: each_scene, prior: people_in_general,")
    asked = asked.replace("licence:", "motor_sound: heard\nlicence:")
    for text, told in ((shipped, False), (asked, True)):
        made = lab.post("/lab/new", data={"csrf": csrf(lab, "/lab/new"), "source": "paste", "yaml": text})
        page = html.unescape(lab.get(made.headers["location"]).text)
        for fact in ("<dt>Prior</dt><dd>people in general", "<dt>Motor sound</dt><dd>on from the start</dd>"):
            assert (fact in page) == told, fact
