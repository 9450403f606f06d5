"""Studies with too little to learn from, protocols with mistakes: told on the command line and on the pages."""

from __future__ import annotations

import json
import re
from pathlib import Path

import httpx
import pytest

from desirepath.store.models import Artefact, Job
from desirepath.study.protocol.freezing import freeze_text, thaw
from desirepath.study.studies import create_study
from tests.faults.conftest import Served
from tests.faults.installation import run_command
from tests.study.walking import QUICK


@pytest.fixture(scope="module")
def experimenter(served: Served) -> httpx.Client:
    browser = httpx.Client(base_url=served.url, timeout=60.0, headers={"Origin": served.url})
    form = {"name": "experimenter", "password": served.installation.password}
    signed_in = browser.post("/lab/sign-in", data=form)
    assert signed_in.status_code == 303, signed_in.text
    return browser


def answered_pairs(served: Served, answers: int) -> str:
    """A participant's code who gave so many answers that count: the first pair is for practice."""
    bot = served.visitor(bot=True)
    step = bot.walk_to_first_trial()["key"]
    for _ in range(1 + answers):
        bot.watch(step)
        step = bot.answer(step, {"choice": "a"}).json()["step"]["key"]
    session = served.installation.session(bot.token)
    with served.installation.database.session() as s:
        return s.get_one(type(session), session.id).participant.code


def test_too_few_answers_on_the_pages(served: Served, experimenter: httpx.Client) -> None:
    page = experimenter.get("/lab/snapshots").text
    csrf = re.search(r'name="csrf" value="([^"]+)"', page)
    assert csrf, page
    for answers in (0, 1):
        code = answered_pairs(served, answers)
        form = {"csrf": csrf.group(1), "study": served.installation.study.id, "participant": code}
        refused = experimenter.post("/lab/snapshots", data=form)
        assert refused.status_code == 422, refused.text
        assert "choose these above to learn from them" in refused.text
        form["answers"] = "simulated"
        refused = experimenter.post("/lab/snapshots", data=form)
        assert refused.status_code == 422, refused.text
        assert f"Usable answers of simulated participants: {'only one' if answers else 0}" in refused.text
        assert "at least two are needed" in refused.text
    with served.installation.database.session() as s:
        assert s.query(Artefact).filter_by(kind="snapshot").count() == 0
        assert s.query(Job).count() == 0


def test_a_study_without_answers_on_the_command_line(served: Served) -> None:
    installation = served.installation
    with installation.database.transaction() as s:
        text = thaw(installation.study).yaml
        empty = create_study(s, installation.files, freeze_text(text), name="Nobody yet", created_by=None).id
    for learn in ("reward-model", "align"):
        refused = run_command("train", learn, "--study", empty, "--json", data=installation.settings.data)
        assert refused.returncode == 1
        assert "only 0 usable answers of people, at least 2 are needed" in json.loads(refused.stdout)["error"]
        assert "Traceback" not in refused.stderr


@pytest.mark.parametrize(
    ("right", "wrong", "told"),
    [
        (
            "view: top_down",
            "view: sideways",
            "mine.yaml:24: stages[4].block.view = 'sideways': must be one of top_down",
        ),
        (
            "study_room/queries_varied_200",
            "study_room/queries_2",
            "mine.yaml:16: query_set = 'study_room/queries_2': is no",
        ),
    ],
)
def test_a_mistake_in_a_protocol_on_the_command_line(tmp_path: Path, right: str, wrong: str, told: str) -> None:
    folder = tmp_path / "protocols"
    folder.mkdir()
    for part in ("texts", "questionnaires"):
        (folder / part).symlink_to(QUICK.parent / part)
    file = folder / "mine.yaml"
    file.write_text(QUICK.read_text().replace(right, wrong, 1))
    for command in (("studies", "create"), ("studies", "check")):
        refused = run_command(*command, str(file), data=tmp_path / "data")
        assert refused.returncode == 1
        assert told in refused.stderr
        assert "Traceback" not in refused.stderr
        assert "error: 1" not in refused.stderr
    machine = run_command("studies", "check", str(file), "--json", data=tmp_path / "data")
    assert machine.returncode == 1
    assert [problem["file"] for problem in json.loads(machine.stdout)["errors"]] == ["mine.yaml"]  # one object, no more
