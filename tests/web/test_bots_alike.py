"""Bots over HTTP and in this process leave the same data; the report finds in them what they were made with."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select

from desirepath.installed import PROTOCOLS
from desirepath.learning.preferences.oracles import ResponseModel
from desirepath.report.findings import analyse
from desirepath.report.planned_design import Assumed
from desirepath.report.simulated_cohorts import Cohort, simulate_data
from desirepath.report.simulated_power import analyse_simulated
from desirepath.report.study_report import write_study_report
from desirepath.report.tidy_tables import read_folder, read_study
from desirepath.settings import Settings
from desirepath.store.dataset.writing import answers_of, export_study
from desirepath.store.models import Study, utc_now
from desirepath.study.planned_power import plan_power
from desirepath.study.protocol.freezing import FrozenProtocol, freeze_text
from desirepath.study.simulated.http import simulate_study
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.simulated.participant import Character
from desirepath.study.studies import create_study
from desirepath.web.application import build_services, create_application
from desirepath.web.core.dependencies import Services
from desirepath.web.lab.report_tab import study_report
from tests.study.walking import twenty_queries

BOTS = 3
CHARACTER = Character(
    response_model=ResponseModel(lapse_rate=0.2),
    seed=4,
    cohort=Cohort(seed=2, second_shown=0.2, preferences={"top_down": "shortest"}),
)
LEFT_TO_CHANCE = {"response", "trial", "session", "probe_of", "consent", "phase_since", "client_time", "decision_s"}
PORT = 18_700


@pytest.fixture(scope="module")
def protocol(tmp_path_factory: pytest.TempPathFactory) -> FrozenProtocol:
    """The interface study with three pairs per view."""
    text = (PROTOCOLS / "interface_study.yaml").read_text()
    queries = twenty_queries(tmp_path_factory.mktemp("queries"))
    shorter = text.replace("study_room/queries_500", str(queries)).replace("count: 25, probes: {repeat: 5}", "count: 3")
    assert shorter.count("count: 3}") == 1
    return freeze_text(shorter)


@pytest.fixture(scope="module")
def empty(protocol: FrozenProtocol, tmp_path_factory: pytest.TempPathFactory) -> Path:
    data = tmp_path_factory.mktemp("empty") / "data"
    services = build_services(Settings(data=data, _env_file=None))
    with services.database.transaction() as s:
        create_study(s, services.files, protocol, name="Views", created_by=None)
    services.database.close()
    return data


def opened(folder: Path) -> tuple[Services, Study]:
    services = build_services(Settings(data=folder, _env_file=None))
    with services.database.session() as s:
        return services, s.scalars(select(Study)).one()


@pytest.fixture(scope="module")
def in_process(empty: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Services, Study]:
    services, study = opened(shutil.copytree(empty, tmp_path_factory.mktemp("here") / "data"))
    told = walk_in_process(services.database, services.files, study, BOTS, CHARACTER)
    assert (told["completed"], told["participants"]) == (BOTS, BOTS)
    return services, study


@pytest.fixture(scope="module")
def over_http(empty: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Services, Study]:
    services, study = opened(shutil.copytree(empty, tmp_path_factory.mktemp("http") / "data"))
    with TestClient(create_application(services), client=("127.0.0.1", PORT)) as client:
        assert simulate_study("", study.recruiting_token, BOTS, CHARACTER, client=client)["completed"] == BOTS
    return services, study


def left(services: Services, study: Study) -> dict[str, list[dict[str, Any]]]:
    """What a walk stored, without ids and times."""
    with services.database.session() as s:
        tables = answers_of(s, study)
    tables["sessions"] = [
        {name: row[name] for name in ("participant", "seed", "plan", "state")} for row in tables["sessions"]
    ]
    for name in ("trials", "responses"):
        tables[name] = [
            {key: value for key, value in row.items() if key not in LEFT_TO_CHANCE and not key.endswith("_at")}
            for row in tables[name]
        ]
    tables["participants"] = [
        {name: row[name] for name in ("participant", "simulated", "oracle")} for row in tables["participants"]
    ]
    return tables


def test_both_ways_leave_the_same_data(in_process, over_http):
    here, there = left(*in_process), left(*over_http)
    assert len(here["responses"]) == BOTS * (1 + 1 + 1 + 3 * (1 + 1 + 3 + 1) + 2 + 1)
    for name, rows in here.items():
        assert rows == there[name], name


def test_the_report_reads_what_the_bots_were_made_with(in_process, tmp_path):
    services, study = in_process
    with services.database.session() as s:
        data, load = read_study(s, services.files, study)
    found = analyse(data, load, "simulated")
    assert found.conditions == ("first_person", "immersive", "top_down")
    assert [one.item.key for one in found.items][:2] == ["ease", "confidence"]  # as the questionnaire asks them
    assert not found.deviations
    assert found.declared_hash == found.plan_hash
    simulated = analyse_simulated(simulate_data(CHARACTER.cohort, BOTS), found.plan)
    means = {one.item.key: {name: mean.mean for name, mean in one.means.items()} for one in found.items}
    assert means == {one.item.key: {name: mean.mean for name, mean in one.means.items()} for one in simulated.items}
    assert {one.item.key: one.places for one in found.rankings} == {o.item.key: o.places for o in simulated.rankings}
    export_study(services.database, services.files, study.id, tmp_path / "export")
    again, load_again = read_folder(tmp_path / "export")
    assert analyse(again, load_again, "simulated") == found


def test_the_report_is_a_page_with_figures_and_their_data(in_process, tmp_path):
    services, study = in_process
    with services.database.session() as s:
        data, load = read_study(s, services.files, study)
    told = write_study_report(data, load, tmp_path, who="simulated", command="desirepath studies report")
    page = (tmp_path / "report.html").read_text()
    assert "<strong>Simulated.</strong>" in page
    assert "The analysis is the one that the protocol declared." in page
    assert "http" not in page.replace("http://www.w3.org", "")  # it needs nothing from elsewhere
    names = {Path(path).stem for path in told["figures"]}
    assert {"items", "rankings", "agreement"} <= names
    assert page.count("data:image/svg+xml;base64,") == len(names)
    assert len((tmp_path / "tests.csv").read_text().splitlines()) == told["tests"] + 1


def test_power_of_the_study_as_it_is_planned(protocol):
    found = plan_power(protocol, [5, 40], Assumed("immersive", "fun", effect=1.2), walk=3, cohorts=12)
    assert found.walked == {"participants": 3, "completed": 3, "responses": 3 * 24}
    assert found.design.conditions == ("first_person", "immersive", "top_down")
    few, many = (one.rates[0] for one in found.power)
    assert few.test == "Friedman, fun (over 10 items)"
    assert few.rate < many.rate
    with pytest.raises(ValueError, match="item = 'joy'"):
        plan_power(protocol, [5], Assumed(item="joy"), walk=3, cohorts=1)


def test_the_reports_tab_shows_rankings_as_the_full_report(in_process):
    services, study = in_process
    with services.database.session() as s:
        data, load = read_study(s, services.files, study)
        tab = study_report(s, study, "simulated", utc_now())
    found = analyse(data, load, "simulated")
    shown = {item.key: item.counts for item in tab.items if item.mean_ranks}
    assert shown == {one.item.key: {name: of[0] for name, of in one.places.items()} for one in found.rankings}
    assert sum(shown["usefulness"].values()) == BOTS
