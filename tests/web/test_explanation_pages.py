"""The page of what moved the robot: figures of one policy and of two, files, words, and what is refused."""

from __future__ import annotations

import csv
import io
import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from fastapi.testclient import TestClient

from desirepath.settings import Settings
from desirepath.store.shipped_policies import policy_artefact, register_shipped
from desirepath.web.application import build_services, create_application
from desirepath.web.core.dependencies import Services
from tests.web.lab_services import sign_in

PAGE = "/lab/explain"


@pytest.fixture(scope="module")
def services(fresh_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Services]:
    data = shutil.copytree(fresh_data, tmp_path_factory.mktemp("explain") / "data")
    found = build_services(Settings(data=data, _env_file=None))
    with found.database.transaction() as s:
        register_shipped(s, found.files)
    yield found
    found.figures.close()


@pytest.fixture(scope="module")
def known(services: Services) -> SimpleNamespace:
    with services.database.session() as s:
        names = ("study_room/base", "study_room/ensemble/1", "open_field/base")
        base, member, field = (policy_artefact(s, name).id for name in names)
        return SimpleNamespace(base=base, member=member, field=field)


@pytest.fixture
def analyst(services: Services) -> Iterator[TestClient]:
    with TestClient(create_application(services), follow_redirects=False) as client:
        found = sign_in(client)
        found.follow_redirects = True  # addresses of before lead on to those of now
        yield found


def figures(analyst: TestClient, page: str, language: str = "en") -> str:
    """What the page fetches to show below its stage."""
    found = re.search(r'data-part="([^"]*)"', page)
    assert found is not None
    return analyst.get(found[1].replace("&amp;", "&"), headers={"Accept-Language": language}).text


def test_two_policies_are_explained_side_by_side(analyst: TestClient, known: SimpleNamespace) -> None:
    asked = {"policy_a": known.base, "policy_b": known.member, "scene": "3500000003", "command": "turning"}
    page = analyst.get(PAGE, params=asked)
    assert page.status_code == 200, page.text
    below = figures(analyst, page.text)
    sources = re.findall(r'href="(/lab/explain/([ab])/explanation\.csv\?[^"]*)"', below)
    assert [letter for _, letter in sources] == ["a", "b"]
    tables = [analyst.get(source.replace("&amp;", "&")) for source, _ in sources]
    assert [one.headers["content-type"].partition(";")[0] for one in tables] == ["text/csv"] * 2
    first, second = (list(csv.DictReader(io.StringIO(one.text))) for one in tables)
    assert {row["command"] for row in first}
    assert [row["score"] for row in first] != [row["score"] for row in second]
    assert "person" in {row["thing"] for row in first if float(row["score"]) > 0}
    assert below.count('class="ink-line cursor"') == 2  # a chart of each, with the moment under the cursor
    assert below.count('data-moments="policies"') == 2
    lanes = [len(json.loads(found)["lanes"]) for found in re.findall(r'json">(\{"at".*?)</script>', below)]
    assert len(lanes) == 2
    assert all(0 < count <= 7 for count in lanes)
    assert "What one looks at that the other does not" in below
    command = (
        "desirepath policies explain study_room/base --scene 3500000003 --method integrated_gradients --command turning"
    )
    assert command in below
    again = analyst.get(sources[0][0].replace("&amp;", "&"), headers={"If-None-Match": tables[0].headers["etag"]})
    assert again.status_code == 304
    picture = analyst.get(sources[0][0].replace("&amp;", "&").replace(".csv", ".png"))
    assert picture.content.startswith(b"\x89PNG")


def test_policies_are_named_as_on_the_command_line(analyst: TestClient, known: SimpleNamespace) -> None:
    by_name = analyst.get(f"{PAGE}?policy_a=study_room/base&scene=3500000003")
    assert by_name.status_code == 200, by_name.text
    assert '<option value="study_room/base" selected' in by_name.text
    weighed = analyst.get("/lab/live?policy=study_room/conditioned@farther=1&scene=3500000003").text
    assert "farther&#34;: 1.0" in weighed  # where its sliders start
    compared = analyst.get("/lab/compare?policy_a=study_room/base&policy_b=study_room/conditioned@farther=1").text
    assert re.search(f'<option value="{known.base}"[^>]* selected', compared)
    assert 'value="farther=1"' in compared
    assert analyst.get(f"{PAGE}?policy_a=study_room/nobody").status_code == 404


def test_a_policy_with_attention_is_explained_by_whom_it_looked_at(analyst: TestClient) -> None:
    page = analyst.get(f"{PAGE}?policy=crowd_corridor/attention&scene=3500000000")
    assert page.status_code == 200, page.text
    assert "pedestrian 1" in figures(analyst, page.text)


def test_german_pages_name_things_in_german(analyst: TestClient, known: SimpleNamespace) -> None:
    analyst.cookies.set("language", "de")
    page = analyst.get(
        PAGE, params={"policy_a": known.base, "scene": "3500000000", "lang": "de"}, headers={"accept-language": "de"}
    )
    assert page.status_code == 200
    assert "Erklärung (Feature-Attribution)" in page.text
    assert "Säule" in figures(analyst, page.text, "de")


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ({"method": "lime"}, "must be one of integrated_gradients, saliency, smooth_grad"),
        ({"command": "jump"}, "must be one of speed, turning"),
        ({"at": "soon"}, "must be seconds since the start"),
        ({"at": "900"}, "the trajectory has moments from 0 to"),
        ({"scene": "-1"}, "seed"),
    ],
)
def test_what_cannot_be_explained_is_said(
    analyst: TestClient, known: SimpleNamespace, said: dict[str, str], told: str
) -> None:
    page = analyst.get(PAGE, params={"policy": "study_room/base", **said})
    if page.status_code == 200:  # known only when it is explained
        page = analyst.get(f"{PAGE}/figures", params={"policy": "study_room/base", **said})
    assert page.status_code == 422
    assert told in page.text
    assert analyst.get(f"{PAGE}/a/explanation.png", params={"policy_a": known.base, **said}).status_code == 404


def test_other_setups_and_letters_are_refused(analyst: TestClient, known: SimpleNamespace) -> None:
    assert analyst.get(PAGE, params={"policy_a": known.base, "policy_b": known.field}).status_code == 422
    assert analyst.get(f"{PAGE}/b/explanation.png", params={"policy_a": known.base}).status_code == 404
    assert analyst.get(PAGE, params={"policy_a": "nothing"}).status_code == 404
