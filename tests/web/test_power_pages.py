"""Power from the page: a form, a run in the background, its result, and the command that computes the same."""

from __future__ import annotations

import html
import os
import re
import subprocess
import sys
import time
from pathlib import Path

from fastapi.testclient import TestClient

from desirepath.installed import PROTOCOLS
from desirepath.jobs.process import ONE_THREAD
from desirepath.report.planned_design import Assumed
from desirepath.study.planned_power import plan_power
from desirepath.study.protocol.freezing import freeze_text
from desirepath.web.core.dependencies import Services
from desirepath.web.lab.power_runs import PowerAsked
from tests.web.lab_services import Walked, csrf

PROTOCOL = """
protocol: two_views
version: 1
title: {en: Two views, de: Zwei Ansichten}
languages: [en, de]
query_set: study_room/queries_varied_200
stages:
  - information: {text: texts/information.md}
  - consent: {text: texts/interface_consent.md, version: 1}
  - block:
      each: [top_down, first_person]
      trials: [{queries: {count: 2}}]
      after: [{questionnaire: {use: interface_items}}]
  - debriefing: {text: texts/debriefing.md, completion_code: random}
"""
SELECT = re.compile(r'<select id="([a-z]+)"[^>]*>(.*?)</select>', re.DOTALL)
BEGINS = f"""
import time
from pathlib import Path
from desirepath.web.lab.power_runs import PowerAsked, PowerRuns
from desirepath.settings import Settings

def children():
    return [one for task in Path("/proc/self/task").iterdir() for one in (task / "children").read_text().split()]

PowerRuns(Settings(_env_file=None)).begin("hash", PowerAsked(), {str(PROTOCOLS / "interface_study.yaml")!r})
while not children():
    time.sleep(0.05)
print(*children(), flush=True)
time.sleep(600)
"""
ASKED = {"participants": "5, 8", "effect": "1", "cohorts": "20"}
LONGEST_S = 240


def drafted(lab: TestClient) -> str:
    """Address of a draft of that protocol."""
    made = lab.post("/lab/new", data={"csrf": csrf(lab, "/lab/new"), "source": "paste", "yaml": PROTOCOL})
    assert made.status_code == 303, made.text
    return str(made.headers["location"])


def test_power_of_a_draft_is_computed_in_the_background_as_by_the_command(lab: TestClient, lab_services: Services):
    draft = drafted(lab)
    assert f'href="{draft}/power"' in lab.get(draft).text
    page = lab.get(f"{draft}/power").text
    assert "Nothing computed yet" in page
    assert 'name="own"' not in page, "this study compares no policies"
    assert 'name="shown"' not in page
    begun = lab.post(f"{draft}/power", data={"csrf": csrf(lab, f"{draft}/power"), **ASKED})
    assert begun.status_code == 303
    there = begun.headers["location"].partition("#")[0]
    assert f'data-live="{there}"' in html.unescape(lab.get(there).text)
    until = time.monotonic() + LONGEST_S
    while "data-live" in (page := html.unescape(lab.get(there).text)):
        assert time.monotonic() < until, page
        time.sleep(0.5)
    options = "--participants 5,8 --effect 1 --cohorts 20"
    assert f"desirepath studies power two_views.yaml {options}" in page
    found = plan_power(freeze_text(PROTOCOL, folder=PROTOCOLS), [5, 8], Assumed(effect=1), cohorts=20).as_dict()
    for row in found["rows"]:
        assert f'<th scope="row">{row["test"]}</th>' in page
        assert f"{row['power']:.0%} <span" in page
    csv_link = re.search(r'href="([^"]+power\.csv[^"]*)"', page)
    assert csv_link
    rows = lab.get(csv_link[1]).text.splitlines()
    assert len(rows) == 1 + len(found["rows"])
    assert lab.get(csv_link[1].replace(".csv", ".svg")).headers["content-type"].startswith("image/svg")


def test_what_cannot_be_asked_is_said_beside_the_field(lab: TestClient):
    draft = drafted(lab)
    token = csrf(lab, f"{draft}/power")
    for wrong, told in (
        ({"participants": "2"}, "Participants: needs a number from 3 to 500."),
        ({"participants": "10, many"}, "Participants: needs a number from 3 to 500."),
        ({"effect": "nan"}, "Effect: needs a number from 0 to 3."),
        ({"cohorts": "20.5"}, "Simulated studies: needs a number from 20 to 1,000."),
    ):
        refused = lab.post(f"{draft}/power", data={"csrf": token, **wrong})
        assert refused.status_code == 422
        assert told in html.unescape(refused.text)
        assert 'aria-invalid="true"' in refused.text
    assert lab.get(f"{draft}/power/power.csv").status_code == 404


def test_the_condition_and_the_item_of_the_effect_are_chosen_on_the_page(lab: TestClient):
    draft = drafted(lab)
    page = lab.get(f"{draft}/power").text
    choices = {name: re.findall(r'<option value="([a-z_]+)"', of) for name, of in SELECT.findall(page)}
    assert choices["condition"] == ["top_down", "first_person"]
    assert choices["item"][:2] == ["ease", "confidence"]
    assert "ranking" not in choices, "nothing is ranked in this protocol"
    chosen = {"participants": "5", "cohorts": "20", "condition": "top_down", "item": "fun"}
    shown = html.unescape(lab.get(f"{draft}/power", params=chosen).text)
    assert '<option value="fun" selected>It was fun. (fun)</option>' in shown
    assert '<option value="top_down" selected>from above</option>' in shown
    refused = lab.post(f"{draft}/power", data={"csrf": csrf(lab, f"{draft}/power"), **chosen, "item": "nonsense"})
    assert refused.status_code == 422
    assert "Item: not in this protocol." in html.unescape(refused.text)
    asked = PowerAsked.of(chosen, choices)
    assert asked.command("FILE").endswith("--participants 5 --cohorts 20 --condition top_down --item fun")
    assert PowerAsked.of(asked.query, choices) == asked


def test_an_analysis_ends_with_the_server_that_began_it(tmp_path: Path):
    """Killed with no time for anything, it leaves no process that computes on for minutes."""
    own = {**os.environ, **ONE_THREAD, "DESIREPATH_DATA": str(tmp_path)}
    server = subprocess.Popen([sys.executable, "-c", BEGINS], stdout=subprocess.PIPE, text=True, env=own)
    assert server.stdout is not None
    child = int(server.stdout.readline())
    server.kill()
    server.wait()
    until = time.monotonic() + 60
    while runs(child):
        assert time.monotonic() < until, "it computes on"
        time.sleep(0.1)


def runs(process: int) -> bool:
    try:
        return bool(Path(f"/proc/{process}/cmdline").read_bytes())  # empty for one that ended and nobody asked after
    except FileNotFoundError:
        return False


def test_a_study_that_is_there_has_the_same_page_and_is_named_by_its_id(
    lab: TestClient, lab_services: Services, walked: Walked, tmp_path: Path
):
    here = f"/lab/studies/{walked.id}"
    assert f'href="{here}/power"' in lab.get(f"{here}/protocol").text
    assert 'name="own"' in lab.get(f"{here}/power").text, "the own policy is compared there"
    refused = lab.post(f"{here}/power", data={"csrf": csrf(lab, f"{here}/power"), "own": "2"})
    assert "Own policy: needs a number from 0 to 1." in html.unescape(refused.text)
