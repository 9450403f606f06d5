"""The editor of a draft: forms and YAML say the same, whatever is changed where, and nothing but that changes."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from fastapi.testclient import TestClient

from desirepath.installed import FRONTEND
from desirepath.store.models import Artefact
from desirepath.study.protocol.freezing import find_shipped_protocols
from desirepath.study.protocol.schema import json_schema
from desirepath.study.protocol.stages import STAGES
from desirepath.web.core.catalogues import Texts
from desirepath.web.core.dependencies import Services
from tests.web.lab_services import csrf

QUICK = next(file for file in find_shipped_protocols() if file.stem == "quick_preference_study").read_text()


class Editor:
    """A draft's page, as its script uses it."""

    def __init__(self, lab: TestClient, **form: str) -> None:
        self.lab, self.token = lab, csrf(lab)
        made = lab.post("/lab/new", data={"csrf": self.token, **form})
        assert made.status_code == 303, made.text
        self.here, self.yaml, self.mark = made.headers["location"], "", ""
        self.answer = self.send()

    def send(self, yaml: str | None = None, **change: Any) -> dict[str, Any]:
        if not self.yaml:
            page = self.lab.get(self.here).text
            (area,) = re.findall(r"<textarea[^>]*>(.*?)</textarea>", page, re.DOTALL)
            (self.mark,) = re.findall(r'data-mark="(\w+)"', page)
            self.yaml = html.unescape(area)
        body = {"seen": self.mark, "yaml": self.yaml if yaml is None else yaml, "change": change or None}
        answered = self.lab.post(f"{self.here}/edit", json=body, headers={"X-CSRF": self.token})
        assert answered.status_code == 200, answered.text
        self.answer = answered.json()
        self.yaml, self.mark = self.answer["yaml"], self.answer["mark"]
        return self.answer

    def add(self, kind: str, index: int | None = None) -> dict[str, Any]:
        index = len(self.data["stages"]) if index is None else index
        return self.send(do="insert", path=["stages"], index=index, kind=kind)

    @property
    def data(self) -> Any:
        return yaml.safe_load(self.yaml)

    @property
    def kinds(self) -> list[str]:
        return [next(iter(stage)) for stage in self.data["stages"]]


def fields_of(part: str) -> dict[tuple[str | int, ...], str]:
    """Path -> type of every field of the forms."""
    found = re.findall(r'data-path="([^"]+)" data-type="(\w+)"', part)
    return {tuple(json.loads(html.unescape(path))): kind for path, kind in found}


def test_a_study_is_made_from_nothing_by_forms_alone(lab: TestClient):
    editor = Editor(lab, source="empty", title="Which drive: A or B?")
    assert editor.data["protocol"] == "which_drive_a_or_b"
    assert [problem["message"] for problem in editor.answer["problems"]] == ["stages: must not be empty"]
    for kind in ("consent", "block", "questionnaire", "debriefing"):
        editor.add(kind)
    editor.add("instruction", 3)
    editor.send(do="move", path=["stages"], index=3, to=1)
    assert editor.kinds == ["consent", "instruction", "block", "questionnaire", "debriefing"]
    editor.send(do="set", path=["stages", 2, "block", "trials", 0, "queries", "count"], value=900)
    (problem,) = editor.answer["problems"]
    assert "must be at most 200" in problem["message"]
    assert "count: 900" in editor.yaml.splitlines()[problem["line"] - 1]
    editor.send(do="set", path=["stages", 2, "block", "trials", 0, "queries", "count"], value=12)
    editor.send(do="insert", path=["stages", 2, "block", "before"], index=0, kind="instruction")
    assert editor.answer["problems"] == []
    assert "The protocol is valid" in editor.answer["part"]
    opened = lab.post(f"{editor.here}/open", data={"csrf": editor.token, "name": "From nothing"})
    assert opened.status_code == 303


@pytest.mark.parametrize("kind", STAGES)
def test_every_kind_of_stage_can_be_added_and_filled_in(lab: TestClient, kind: str):
    editor = Editor(lab, source="shipped:quick_preference_study")
    before = editor.yaml
    answer = editor.add(kind, 2)
    assert answer["refused"] is None
    assert editor.data["stages"][2].keys() == {kind}
    assert not any(
        problem["message"].startswith("stages[2].") and "must be" in problem["message"]
        for problem in answer["problems"]
    )
    fields = {path: of for path, of in fields_of(answer["part"]).items() if path[:2] == ("stages", 2)}
    assert fields, "a form without a field"
    for path in fields:
        value = 3 if fields[path] == "number" else None
        if value is not None:
            assert editor.send(do="set", path=list(path), value=value)["refused"] is None, path
    assert editor.send(do="remove", path=["stages", 2])["refused"] is None
    assert editor.yaml == before


@pytest.mark.parametrize("file", find_shipped_protocols(), ids=lambda file: file.stem)
def test_every_shipped_protocol_is_shown_whole_and_stays_as_it_is(lab: TestClient, file: Path):
    editor = Editor(lab, source=f"shipped:{file.stem}")
    assert editor.yaml == file.read_text()
    assert editor.answer["problems"] == []
    assert editor.answer["part"].count('class="handle plain"') == len(editor.data["stages"])
    fields = fields_of(editor.answer["part"])
    assert ("minutes",) in fields
    assert ("query_set",) in fields
    assert "editor." not in re.sub(r"<[^>]+>", "", editor.answer["part"])


def test_errors_stand_at_their_line_while_the_forms_stay_until_the_yaml_can_be_read_again(lab: TestClient):
    editor = Editor(lab, source="shipped:quick_preference_study")
    line = next(n for n, text in enumerate(QUICK.splitlines(), 1) if "view: top_down" in text)
    wrong = editor.send(QUICK.replace("view: top_down", "view: from_above", 1))
    assert [(one["line"], one["message"].split(":")[0]) for one in wrong["problems"]] == [
        (line, "stages[4].block.view")
    ]
    assert "<li data-index" in wrong["part"]
    shown = re.findall(r'href="(/lab/new/\w+/preview/\d+)"[^>]*>[^<]*<span class="unseen">: ([^<]+)', wrong["part"])
    assert "Block" not in dict(map(reversed, shown))
    assert len(shown) >= 4  # what can be looked at without that stage
    assert [lab.get(address).status_code for address, _ in shown] == [200] * len(shown)
    untitled = editor.send(QUICK.replace("title:", "titel:", 1))
    assert "/preview/" not in untitled["part"]
    assert "There is no preview yet" in untitled["part"]
    broken = editor.send(QUICK.replace("stages:", "stages: [", 1))
    assert broken["part"] is None
    assert "is not valid YAML" in broken["problems"][0]["message"]
    refused = editor.send(do="remove", path=["stages", 0])
    assert "cannot be read" in refused["refused"]
    assert refused["yaml"] == broken["yaml"]


def test_what_only_the_author_can_change_is_refused_in_words(lab: TestClient):
    editor = Editor(lab, source="paste", yaml="a: &x {b: 1}\nstages: []\nc: *x\n")
    for change in (
        {"do": "set", "path": ["a", "b"], "value": 2},
        {"do": "insert", "path": ["title"], "index": 0},
        {"do": "insert", "path": ["stages"], "index": 5, "kind": "consent"},
        {"do": "insert", "path": ["nowhere"], "index": 0},
        {"do": "move", "path": ["stages"], "index": 0, "to": 1},
        {"do": "remove", "path": ["stages", 3]},
    ):
        before = editor.yaml
        assert editor.send(**change)["refused"], change
        assert editor.yaml == before


def test_a_window_that_did_not_see_anothers_change_overwrites_nothing(lab: TestClient):
    one = Editor(lab, source="shipped:quick_preference_study")
    old, mark = one.yaml, one.mark
    one.send(do="set", path=["minutes"], value=20)
    changed = one.yaml
    one.yaml, one.mark = old, mark  # as another window that was opened before
    refused = one.send(do="set", path=["version"], value=2)
    assert "another window" in refused["refused"]
    assert (refused["yaml"], refused["mark"]) == (old, mark), "what was written there stays"
    assert one.send(changed)["refused"] is None, "who has the text that is kept goes on"
    assert yaml.safe_load(one.send(do="set", path=["version"], value=2)["yaml"])["minutes"] == 20


def test_what_no_page_sends_is_not_taken(lab: TestClient):
    editor = Editor(lab, source="shipped:quick_preference_study")
    headers = {"X-CSRF": editor.token}
    for body in (
        {},
        {"yaml": QUICK},
        {"seen": "x", "yaml": 1},
        {"seen": "x", "yaml": "x" * (512 * 1024 + 1)},
        {"seen": "x", "yaml": QUICK, "change": {"do": "burn"}},
        {"seen": "x", "yaml": QUICK, "change": {"do": "remove", "path": []}},
        {"seen": "x", "yaml": QUICK, "change": {"do": "remove", "path": ["a"] * 40}},
        {"seen": "x", "yaml": QUICK, "change": {"do": "move", "path": ["stages"], "index": -1, "to": 0}},
    ):
        assert lab.post(f"{editor.here}/edit", json=body, headers=headers).status_code in (413, 422), body
    assert lab.post(f"{editor.here}/edit", json={"seen": "x", "yaml": QUICK}).status_code == 403
    empty = editor.send(" ")
    assert "empty" in empty["refused"]
    assert editor.send(QUICK)["problems"] == []


def test_minutes_and_power_stand_beside_it(lab: TestClient, lab_services: Services):
    editor = Editor(lab, source="shipped:quick_preference_study")
    assert re.search(r"<dt>Duration</dt><dd>about \d+ min", editor.answer["part"])
    assert f"{editor.here}/power" in editor.answer["part"]
    longer = re.search(
        r"about (\d+) min",
        editor.send(do="set", path=["stages", 4, "block", "trials", 1, "queries", "count"], value=60)["part"],
    )
    assert longer is not None
    assert int(longer[1]) > 25


def test_the_schema_and_what_there_is_to_name_are_told(lab: TestClient, lab_services: Services):
    with lab_services.database.transaction() as s:
        card = {"stored_queries": [{}]}
        s.add(Artefact(id="a" * 64, kind="query_set", name="Our cart, polite", setup="study_room", card=card))
    editor = Editor(lab, source="shipped:quick_preference_study")
    assert f'<option value="{"a" * 64}">Our cart, polite (study_room)</option>' in editor.answer["part"]
    known = lab.get(f"{editor.here}/schema.json").json()
    assert known["protocol"] == json_schema()
    assert "texts/consent.md" in known["names"]["text"]
    assert "demographics" in known["names"]["use"]
    assert "study_room/queries_500" in known["names"]["query_set"]


def test_german_pages_have_german_forms(lab: TestClient):
    lab.get("/lab/language/de")
    editor = Editor(lab, source="empty", title="Wie fährt er?")
    assert list(editor.data["title"]) == ["de", "en"]
    editor.add("block")
    for words in ("Neuer Abschnitt", "Ansicht", "von oben", "Durchgänge", "Weitere Einstellungen"):
        assert words in editor.answer["part"], words


def test_every_key_and_every_word_of_the_schema_is_said_in_both_languages(lab_services: Services):
    schema = json_schema()
    parts = [schema, *schema["$defs"].values()]
    keys = {key for part in parts for key in part.get("properties", {})} - {*STAGES, "stages"}
    for language in ("en", "de"):
        t = lab_services.texts.get(language)
        assert sorted(key for key in keys if not t.knows(f"editor.fields.{key}")) == []


def test_codemirrors_modules_are_as_published_and_need_nothing_that_is_missing():
    """Where npm was there at installation."""
    modules = FRONTEND / "static" / "npm"
    if not modules.is_dir():
        pytest.skip("npm was not there")
    wanted = json.loads((FRONTEND.parent / "package.json").read_text())["dependencies"]
    assert {path.stem for path in modules.glob("*.js")} == {name.lstrip("@").replace("/", "-") for name in wanted}
    for path in modules.glob("*.js"):
        used = re.findall(r"^(?:import|export)\s[^;'\"()=]*from\s*['\"]([^'\"]+)", path.read_text(), re.MULTILINE)
        assert all((modules / name).is_file() for name in used), path.name
        assert path.with_suffix(".LICENSE").is_file()


def test_every_value_that_a_protocol_may_have_is_offered_in_words():
    """Names of setups that a lab brings, and of its files, stay as they are."""

    def named(node: Any) -> set[str]:
        if isinstance(node, list):
            return set().union(*map(named, node))
        if not isinstance(node, dict):
            return set()
        here = {one for one in (*node.get("enum", ()), node.get("const")) if isinstance(one, str)}
        return here.union(*map(named, node.values()))

    for language in ("en", "de"):
        t = Texts(FRONTEND / "locales").get(language)
        values = named(json_schema())
        assert len(values) > 40
        assert sorted(one for one in values if not t.knows(f"editor.values.{one}")) == []
