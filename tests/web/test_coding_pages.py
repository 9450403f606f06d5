"""Open questions are read: two coders, blind, a codebook of the lab's own, their agreement, what they settle on."""

from __future__ import annotations

import re

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select, update

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.dataset.importing import import_dataset
from desirepath.store.dataset.writing import export_study
from desirepath.store.erasure import erase_participant
from desirepath.store.models import CodebookCode, Coding, Participant, User
from desirepath.web.application import create_application
from desirepath.web.core.auth import add_user
from desirepath.web.core.dependencies import Services
from tests.store.small_study import SmallStudy
from tests.web.lab_services import csrf, sign_in

WRITTEN = {"P1": "It kept away from me", "P2": "It took the shortest way", "P3": "It slowed down", "P4": "No idea"}
QUESTIONNAIRE = """
title: {en: Words, de: Worte}
blocks:
  - items:
      - {key: remark, type: text, text: {en: "What rules did it follow?", de: "Welchen Regeln folgte er?"}}
"""


@pytest.fixture
def written(lab_services: Services, monkeypatch: pytest.MonkeyPatch) -> SmallStudy:
    """A study in which four people wrote something and one wrote nothing."""
    import tests.store.small_study as small

    monkeypatch.setattr(
        small,
        "FILES",
        {"questionnaires/background.yaml": QUESTIONNAIRE, "texts/i.en.md": "# About", "texts/i.de.md": "# Über"},
    )
    monkeypatch.setattr(small, "PROTOCOL_YAML", PROTOCOL)
    study = SmallStudy(lab_services.database, lab_services.files)
    for number, (code, text) in enumerate(WRITTEN.items()):
        study.participant(code, choices="", secret=text, drives=10 * number)
    study.participant("P5", choices="", secret=" ", drives=90)
    return study


PROTOCOL = """
protocol: words
version: 1
title: {en: Words, de: Worte}
languages: [en, de]
query_set: study_room/queries_varied_200
stages:
  - information: {text: texts/i.md}
  - consent: {text: texts/i.md, version: "1"}
  - block: {view: top_down, trials: [{queries: {count: 1}}]}
  - questionnaire: {use: background}
  - debriefing: {text: texts/i.md}
"""


def colleague(services: Services, name: str) -> TestClient:
    password = add_user(services.database, name, "analyst")
    with services.database.transaction() as s:
        s.execute(update(User).where(User.name == name).values(must_change_password=False))
    return sign_in(TestClient(create_application(services), follow_redirects=False), name, password)


class Coder:
    """Somebody who reads answers on the pages."""

    def __init__(self, client: TestClient, study: str) -> None:
        self.client, self.at = client, f"/lab/studies/{study}/coding"
        self.token = csrf(client)

    def post(self, path: str, **data: object) -> int:
        return self.client.post(f"{self.at}/{path}", data={"csrf": self.token, **data}).status_code

    def handed_out(self) -> tuple[str, str] | None:
        """The answer that is to be coded: (response, text)."""
        page = self.client.get(f"{self.at}/remark").text
        text = re.search(r'id="answer">([^<]*)<', page)
        return (re.search(r"answers/(\w+)\"", page)[1], text[1]) if text else None

    def code(self, by_text: dict[str, list[str]], ids: dict[str, str]) -> list[str]:
        """Code everything; returns the texts in the order in which they came."""
        order = []
        while (out := self.handed_out()) is not None:
            response, text = out
            order.append(text)
            codes = [ids[one] for one in by_text[text]]
            given = {"codes": codes} if codes else {"none_fits": "1"}
            assert self.post(f"remark/answers/{response}", **given) == 303
        return order


def codebook(services: Services) -> dict[str, str]:
    with services.database.session() as s:
        return {code.name: code.id for code in s.scalars(select(CodebookCode))}


def test_two_coders_read_every_answer_blind_and_settle_where_they_differ(lab, lab_services, written, tmp_path):
    ada, bob = Coder(lab, written.id), Coder(colleague(lab_services, "bob"), written.id)
    assert ada.post("remark/codes", name="Distance", definition="It keeps away") == 303
    assert ada.post("remark/codes", name="Efficiency", definition="It is quick or short") == 303
    assert ada.post("remark/codes", name="distance", definition="Twice") == 409
    assert ada.post("remark/codes", name="Empty", definition=" ") == 409
    ids = codebook(lab_services)
    first_page = lab.get(f"{ada.at}/remark").text
    form = first_page.partition("<blockquote")[2].partition("</form>")[0]
    shown = form.replace(ada.token, "")  # which is random, and may hold "P1"
    assert "Which codes fit?" in shown
    for telling in (*WRITTEN, "background", "top_down", written.id + "/people/"):  # who, where, under what
        assert telling not in shown

    far, quick, slow, none = WRITTEN.values()
    said = {far: ["Distance"], quick: ["Efficiency"], slow: ["Distance"], none: []}
    other = {**said, slow: ["Distance", "Efficiency"]}
    assert sorted(ada.code(said, ids)) == sorted(WRITTEN.values())
    assert "Cohen" in lab.get(ada.at).text
    response, _ = bob.handed_out()
    assert bob.post(f"remark/answers/{response}") == 422  # neither codes nor "no code fits"
    undecided = {"csrf": bob.token, "codes": [ids["Distance"]], "none_fits": "1"}
    again = bob.client.post(f"{bob.at}/remark/answers/{response}", data=undecided).text
    assert "tick at least one code" in again
    assert f"answers/{response}" in again  # the same answer, with what was ticked
    assert again.count(" checked") == 2
    assert bob.post(f"remark/answers/{response}", codes=["nothing"]) == 404
    assert len(bob.code(other, ids)) == 4
    carol = Coder(colleague(lab_services, "carol"), written.id)
    assert carol.client.get(f"{carol.at}/remark").status_code == 409
    assert carol.post(f"remark/answers/{response}", codes=[ids["Distance"]]) == 409

    page = lab.get(ada.at).text
    assert "4 of 4 coded" in page
    assert re.search(r">1\.00<", page)  # Distance: the same every time, which tells no interval
    assert "0.50" in page  # Efficiency: 3 of 4 alike, chance 1/2
    assert "Differences (1 open)" in page
    differing = lab.get(f"{ada.at}/remark/differences").text
    assert slow in differing
    assert quick not in differing
    asked = re.search(r"answers/(\w+)/settle", differing)[1]
    assert bob.post(f"remark/answers/{asked}", codes=[ids["Distance"]]) == 409  # what was said stays
    assert bob.post(f"remark/answers/{asked}/settle", codes=[ids["Distance"]]) == 303
    page = lab.get(ada.at).text
    assert "Differences (0 open)" in page
    assert "2 of 4" in page  # have Distance
    assert re.search(r">1\.00<", page)
    assert "0.50" in page  # agreement stays what it was before they talked
    assert ada.post(f"remark/codes/{ids['Distance']}/remove") == 409

    taken = lab.get(f"{ada.at}/remark/codings.csv").text.splitlines()
    assert taken[0].startswith("response,session,participant,simulated,excluded,item,coder,code,coded_at")
    assert len(taken) == 1 + 4 + 5 + 1
    assert not any(name in line for line in taken for name in ("experimenter", "bob"))

    export_study(written.database, written.files, written.id, tmp_path / "set")
    rows = (tmp_path / "set" / "codings.csv").read_text().splitlines()
    assert sorted(one.split(",")[6:8] for one in rows[1:]) == sorted(one.split(",")[6:8] for one in taken[1:])
    assert "Efficiency" in (tmp_path / "set" / "codebook.csv").read_text()


def test_codings_come_back_with_a_data_set_and_go_with_their_person(lab, lab_services, written, tmp_path):
    ada = Coder(lab, written.id)
    ada.post("remark/codes", name="Distance", definition="It keeps away")
    ada.code({text: ["Distance"] for text in WRITTEN.values()}, codebook(lab_services))
    export_study(written.database, written.files, written.id, tmp_path / "set")
    there = Database(f"sqlite:///{tmp_path / 'there.sqlite'}")
    there.migrate()
    files = ArtefactStore((tmp_path / "there").as_uri())
    import_dataset(there, files, tmp_path / "set")
    export_study(there, files, written.id, tmp_path / "again")
    for name in ("codings.csv", "codebook.csv"):
        assert (tmp_path / "again" / name).read_text() == (tmp_path / "set" / name).read_text()
    there.close()

    with written.database.session() as s:
        person = s.scalars(select(Participant.id).where(Participant.code == "P1")).one()
        assert len(s.scalars(select(Coding)).all()) == 4
    done = erase_participant(written.database, written.files, person, by="tester")
    assert done["counts"]["codings"] == 1
    with written.database.session() as s:
        assert len(s.scalars(select(Coding)).all()) == 3


def test_the_pages_speak_both_languages(lab, written):
    lab.cookies.set("desirepath_lab_language", "de")
    page = lab.get(f"/lab/studies/{written.id}/coding").text
    assert "Welchen Regeln folgte er?" in page
    assert "Offene Fragen" in page
    assert "Codebuch" in page
    assert lab.get(f"/lab/studies/{written.id}/coding/nothing").status_code == 404
