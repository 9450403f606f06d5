"""The page of any model or policy opens, whatever is on its card, and says how well its answers predict others."""

from __future__ import annotations

import re
from dataclasses import asdict
from typing import Any

import pytest

from desirepath.learning.shipped_files import load_card, shipped_names
from desirepath.store.artefacts import ARTEFACT_KINDS, save_artefact
from desirepath.web.core.dependencies import Services

HELD_OUT = {"answers": 15, "scenes": 15, "folds": 3, "accuracy": 0.6, "low": 0.36, "high": 0.8, "log_likelihood": -0.66}
PREDICTED = {
    "accuracy": 0.51,
    "low": 0.4,
    "high": 0.62,
    "n": 80,
    "chance": 0.5,
    "majority": 0.55,
    "verdict": "no_better_than_chance",
}
CARDS: dict[str, dict[str, Any]] = {
    "nothing": {},
    "no results": {"results": {}},
    "an alignment's": {"results": {"held_out": HELD_OUT, "training_accuracy": 0.9, "answers": 15}},
    "held out is none": {"results": {"held_out": None, "predicted": PREDICTED}},
    "per participant": {"results": {"held_out": [{"participant": "P-1", "n": 2, "reason": "too_few_answers"}]}},
    "before it was measured": {
        "results": {"training_accuracy": 0.9, "answers": 15},
        "parents": {"answers: a": "0" * 64},
    },
}


def add(services: Services, kind: str, name: str, card: dict[str, Any], parent: str) -> str:
    with services.database.transaction() as s:
        made = save_artefact(
            s, services.files, kind=kind, name=name, setup="study_room", content=name.encode(), card=card,
            parents=[(parent, "answers")],
        )  # fmt: skip
        return made.id


@pytest.mark.parametrize("language", ["en", "de"])
def test_a_model_s_page_opens_whatever_is_on_its_card(lab, lab_services, two_studies, language):
    lab.headers["Accept-Language"] = language
    for told, card in CARDS.items():
        for kind in set(ARTEFACT_KINDS) - {"snapshot"}:  # which has a page of its own
            made = add(lab_services, kind, f"{kind} with {told}", card, two_studies.snapshot["ours"])
            page = lab.get(f"/lab/artefacts/{made}", follow_redirects=True)
            assert page.status_code == 200, (kind, told)
            assert lab.get(f"/lab/artefacts/{made}/upkeep").status_code == 200, (kind, told)


@pytest.mark.parametrize("language", ["en", "de"])
def test_the_page_of_everything_shipped_opens(lab, lab_services, two_studies, language):
    lab.headers["Accept-Language"] = language
    opened = set()
    for name in shipped_names():
        card = load_card(name)
        if card.kind in ARTEFACT_KINDS:
            opened.add(card.kind)
            made = add(lab_services, card.kind, name, asdict(card), two_studies.base)
            assert lab.get(f"/lab/artefacts/{made}", follow_redirects=True).status_code == 200, name
    assert lab.get(f"/lab/policies/{two_studies.base}").status_code == 200, "with all of it made from it"
    assert opened >= {"policy", "conditioned_policy", "attention_policy", "query_set", "ranking_set"}
    listed = lab.get("/lab/policies").text
    assert {"en": "24 scenarios", "de": "24 Szenarien"}[language] in listed.partition('id="ranking_set"')[2]
    attending = listed.partition("crowd_corridor/attention")[2].partition("</tr>")[0].replace("\xa0", " ")
    reached = load_card("crowd_corridor/attention").results["policy"]
    said = f"{reached['success']:.1f}", f"{reached['min_human_distance_m']:.2f}"
    percent, metres = (one.replace(".", ",") if language == "de" else one for one in said)
    assert {"en": f"{percent}%", "de": f"{percent} %"}[language] in attending
    assert f"{metres} m" in attending


def test_the_list_of_policies_has_one_main_action_and_every_drawing_leads_to_the_policy_driving(lab, two_studies):
    page = lab.get("/lab/policies").text
    head = page[page.index("<h1>") : page.index('class="filters"')]
    assert (head.count("button main"), head.count('class="button')) == (1, 2), "compare, and what makes a new one"
    assert [
        one for one in ("/lab/jobs/new/train_base", "#upload", "/lab/settings/setups") if f'"{one}"' not in head
    ] == []
    drawings = re.findall(r'<td class="sketch"><a href="([^"]+)"><picture', page)
    assert f"/lab/flow-field?policy={two_studies.base}" in drawings
    assert len(drawings) == page.count('<picture class="sketch">')


def test_beside_every_model_and_policy_stands_what_its_answers_predict_with_a_warning(lab, lab_services, two_studies):
    weak = add(lab_services, "policy", "weak", {"results": {"predicted": PREDICTED}}, two_studies.snapshot["ours"])
    good = {**PREDICTED, "accuracy": 0.75, "low": 0.64, "high": 0.83, "verdict": "better"}
    strong = add(lab_services, "reward_model", "strong", {"results": {"predicted": good}}, two_studies.snapshot["ours"])
    old = add(lab_services, "policy", "old", CARDS["before it was measured"], two_studies.snapshot["ours"])
    warning, told = "not distinguishable from chance", "51% [40%, 62%] of held-out answers; chance 50%, majority 55%"
    for page in (f"/lab/policies/{weak}", "/lab/policies", f"/lab/snapshots/{two_studies.snapshot['ours']}"):
        shown = lab.get(page).text
        assert told in shown, page
        assert warning in shown, page
    assert "75% [64%, 83%] of held-out answers" in lab.get("/lab/policies").text
    page = lab.get(f"/lab/artefacts/{strong}").text
    assert "predicts better than chance and majority" in page
    assert warning not in page
    assert "held-out accuracy not measured" in lab.get(f"/lab/policies/{old}").text
    assert "held-out accuracy not measured" not in lab.get(f"/lab/policies/{two_studies.base}").text
