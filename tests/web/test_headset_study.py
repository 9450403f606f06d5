"""The interface study with a headset beside the window: simulated participants over HTTP, the report by device, power.

They have no eyes: what is compared is made up, and marked as simulated."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq

from desirepath.installed import PROTOCOLS
from desirepath.report.findings import analyse
from desirepath.report.planned_design import Assumed
from desirepath.report.report_text import sections
from desirepath.report.simulated_cohorts import Cohort
from desirepath.report.tidy_tables import read_folder, tidy
from desirepath.store.dataset.reading import read_dataset
from desirepath.store.dataset.writing import export_study
from desirepath.study.planned_power import plan_power
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.simulated.http import simulate_study
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from desirepath.web.core.dependencies import Services
from tests.study.walking import twenty_queries

BOTS, PAIRS = 3, 3
FOUR = {"headset", "immersive", "first_person", "top_down"}


def shorter(tmp_path: Path):
    text = (PROTOCOLS / "interface_headset_study.yaml").read_text()
    for old, new in (
        ("study_room/queries_500", str(twenty_queries(tmp_path))),
        ("count: 20, probes: {repeat: 5}", f"count: {PAIRS}"),
        ("{different_scenes: true}", "{}"),
    ):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return freeze_text(text)


def test_the_report_compares_a_headset_with_the_window_and_the_other_views(
    client, services: Services, tmp_path: Path
) -> None:
    frozen = shorter(tmp_path)
    with services.database.transaction() as s:
        made = create_study(s, services.files, frozen, name="Worn", created_by=None)
        study, link = made.id, made.recruiting_token
    cohort = Cohort(seed=2, preferences={"headset": "shortest"})
    assert simulate_study("", link, BOTS, Character("fastest", cohort=cohort), client=client)["completed"] == BOTS
    export_study(services.database, services.files, study, tmp_path / "out")
    trials = pq.read_table(tmp_path / "out" / "trials.parquet").to_pylist()
    assert {(trial["block"], trial["view"], trial["hmd"]) for trial in trials} == {
        ("headset", "immersive", True),
        *((view, view, False) for view in FOUR - {"headset"}),
    }
    assert all(trial["simulated"] for trial in trials)
    data, load = read_folder(tmp_path / "out")
    findings = analyse(data, load, "simulated")
    devices = findings.devices
    assert {(view, device): (seen.people, seen.of.answers) for (view, device), seen in devices.items()} == {
        ("immersive", "headset (simulated)"): (BOTS, BOTS * PAIRS),
        ("immersive, in the window", "none (simulated)"): (BOTS, BOTS * PAIRS),
        ("first_person", "none (simulated)"): (BOTS, BOTS * PAIRS),
        ("top_down", "none (simulated)"): (BOTS, BOTS * PAIRS),
    }
    assert set(findings.conditions) == FOUR
    assert len(findings.between) == 6, "every two of the four"
    rows = next(part for part in sections(findings, [], tmp_path) if part.title == "Views and devices").tables[0].rows
    assert rows[2][:4] == ["immersive, in the window", "none (simulated)", str(BOTS), str(BOTS * PAIRS)]

    dataset = read_dataset(tmp_path / "out")
    for trial in dataset.tables["trials"]:
        if trial["hmd"]:  # as where somebody took it off in between
            trial |= {"hmd": False, "headset": {**trial["headset"], "b": None}}
    data = tidy("Worn", study, dataset.protocol, "", dataset.files, dataset.tables)
    assert ("immersive", "headset and window (simulated)") in analyse(data, load, "simulated").devices

    planned = plan_power(frozen, [6], Assumed(), walk=3, cohorts=3)
    assert set(planned.design.conditions) == FOUR
