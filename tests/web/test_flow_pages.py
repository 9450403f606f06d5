"""The flow-field page over shipped policies: figure, files, numbers, 3D, and what is refused."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fastapi.testclient import TestClient

from desirepath.learning.policies.conditioned import ConditionedPolicy
from desirepath.learning.policies.shipped import load_policy
from desirepath.learning.preferences.objectives import SIZE
from desirepath.settings import Settings
from desirepath.store.artefacts import save_artefact
from desirepath.store.models import Artefact, utc_now
from desirepath.store.shipped_policies import policy_artefact, register_shipped
from desirepath.web.analyst.chosen_policies import Side, first_scene
from desirepath.web.application import build_services, create_application
from desirepath.web.core.dependencies import Services
from desirepath.web.core.figure_process import FigureError, FigureProcess, FlowOrder
from tests.web.lab_services import sign_in

PAGE = "/lab/flow-field"


def conditioned() -> ConditionedPolicy:
    """The shipped base policy of the study room, with weights that pull its arms a little."""
    base = load_policy("study_room/base")
    rows = np.random.default_rng(3).normal(0, 0.3, (SIZE, base.actor[0].shape[1])).astype(np.float32)
    shape = replace(base.shape, task_inputs=base.shape.task_inputs + SIZE)
    return ConditionedPolicy(
        base.setup, shape, (np.concatenate([base.actor[0], rows]), *base.actor[1:]), (), (1.0,) * SIZE
    )


@pytest.fixture(scope="module")
def services(fresh_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Services]:
    found = build_services(
        Settings(data=shutil.copytree(fresh_data, tmp_path_factory.mktemp("flow") / "data"), _env_file=None)
    )
    with found.database.transaction() as s:
        register_shipped(s, found.files)
        save_artefact(
            s, found.files, kind="conditioned_policy", name="study_room/told", setup="study_room",
            content=conditioned().to_bytes(), card={},
        )  # fmt: skip
    yield found
    found.figures.close()


@pytest.fixture(scope="module")
def known(services: Services) -> SimpleNamespace:
    with services.database.session() as s:
        ids = {name: policy_artefact(s, f"study_room/{name}").id for name in ("base", "ensemble/0", "ensemble/1")}
        told = s.query(Artefact).filter_by(name="study_room/told").one().id
        return SimpleNamespace(
            base=ids["base"], member=ids["ensemble/1"], lost=ids["ensemble/0"], told=told,
            field=policy_artefact(s, "open_field/base").id,
        )  # fmt: skip


@pytest.fixture
def analyst(services: Services) -> Iterator[TestClient]:
    with TestClient(create_application(services), follow_redirects=False) as client:
        found = sign_in(client)
        found.follow_redirects = True  # addresses of before lead on to those of now
        yield found


def part(analyst: TestClient, page: str, language: str = "en") -> str:
    """What the page fetches to show below its stage."""
    address = re.search(r'data-part="([^"]*)"', page).group(1).replace("&amp;", "&")
    return analyst.get(address, headers={"Accept-Language": language}).text


def sources(page: str) -> dict[str, str]:
    """Addresses of the figure's files in a page, by file name."""
    found = re.findall(r'(?:src|href)="(/lab/flow-field/([a-z_]+\.[a-z]+)\?[^"]*)"', page)
    return {name: address.replace("&amp;", "&") for address, name in found}


@pytest.mark.parametrize(("language", "says"), [("en", "Flow field of study_room/base"), ("de", "Strömungsfeld von")])
def test_one_policy_is_drawn_with_files_command_and_lineage(analyst, known, language, says):
    page = analyst.get(PAGE, headers={"Accept-Language": language})
    assert page.status_code == 200
    assert "<iframe" in page.text, "nothing has to be chosen first"
    figure = part(analyst, page.text, language)
    assert says in figure
    assert f"desirepath policies flow-field study_room/base --scene {first_scene()}" in figure
    assert f"/lab/artefacts/{known.base}#lineage" in figure
    files = sources(figure)
    assert set(files) == {"flow_field.png", "flow_field.svg", "flow_field.csv"}
    picture = analyst.get(files["flow_field.png"], headers={"Accept-Language": language})
    assert picture.content.startswith(b"\x89PNG")
    assert picture.headers["Content-Type"] == "image/png"
    unchanged = analyst.get(
        files["flow_field.png"], headers={"Accept-Language": language, "If-None-Match": picture.headers["ETag"]}
    )
    assert unchanged.status_code == 304
    assert analyst.get(files["flow_field.csv"]).text.startswith("row,column,x_m,y_m,free,heading_rad,")
    assert "attachment" in analyst.get(files["flow_field.svg"]).headers["Content-Disposition"]


def test_the_command_names_a_shipped_policy_as_commands_know_it_however_it_is_called_here(analyst, services, known):
    with services.database.session() as s, s.no_autoflush:
        s.get_one(Artefact, known.base).name = "our usual robot"
        side = Side(s.get_one(Artefact, known.base), {"farther": 1.0})
        s.expunge_all()  # the other tests know it as it was
    assert (side.name, side.reference) == ("our usual robot@farther=1", "study_room/base@farther=1")


def test_two_policies_are_drawn_with_their_difference_and_shown_in_3d(analyst, services, known):
    was = analyst.get(f"{PAGE}?policy_a={known.base}&policy_b={known.member}&scene=3500000001&stage=1")
    assert was.url.query == b"policy=study_room/base&second=study_room/ensemble/1&scene=3500000001&view=top_down"
    page = was.text
    files = sources(part(analyst, page))
    assert set(files) == {
        *("flow_field.png", "flow_field.svg", "flow_field_a.csv", "flow_field_b.csv", "difference.csv")
    }
    assert "heading_difference_rad" in analyst.get(files["difference.csv"]).text
    token = re.search(r'<iframe[^>]*src="[^"]*/stage/([^/"]+)/"', page).group(1)
    shown = []
    stage = SimpleNamespace(replay=lambda drives, names, beside, **_: shown.append((drives, names, beside)))
    assert services.replays.show(stage, f"replay:{token}")
    drives, names, beside = shown[0]
    assert [one.name[:3] for one in beside] == ["A: ", "B: "]
    assert all(len(one.paths) > 10 for one in beside)
    assert names == ("A: study_room/base", "B: study_room/ensemble/1")
    assert {one.scene.seed for one in drives} == {3_500_000_001}


def test_conditioned_policy_is_asked_what_it_should_be_told(analyst, known):
    asked = f"{PAGE}?policy=study_room/told&second=study_room/told&scene=3500000000"
    refused = analyst.get(asked)
    assert refused.status_code == 422
    assert "the same policy" in refused.text
    assert 'name="a_farther"' in refused.text
    drawn = analyst.get(f"{asked}&b_farther=1&b_smoother=0.5")
    assert drawn.status_code == 200
    assert b"second=study_room/told@farther=1,smoother=0.5" in drawn.url.query
    assert re.search(r'name="b_farther"[^>]*value="1"', drawn.text)
    figure = part(analyst, drawn.text)
    assert f"{known.told} {known.told}@farther=1,smoother=0.5 --scene" in figure, "it was not shipped"
    gaps = [line.split(",")[4] for line in analyst.get(sources(figure)["difference.csv"]).text.splitlines()[1:]]
    assert max(abs(float(gap)) for gap in gaps if gap) > 0.01
    opposites = analyst.get(f"{asked}&b_farther=1&b_closer=1")
    assert opposites.status_code == 422
    assert "opposites" in opposites.text


@pytest.mark.parametrize(
    ("query", "status", "says"),
    [
        ("policy_a={base}&scene=none", 422, "not a scene seed"),
        ("policy_a={base}&scene=99999999999999999", 422, "not a scene seed"),
        ("policy_a={base}&policy_b={field}", 422, "two policies of one setup"),
        ("policy_a={told}&a_farther=7", 422, "not a weight"),
        ("policy_a=unknown", 404, "nothing under this address"),
    ],
)
def test_what_cannot_be_drawn_is_told(analyst, known, query, status, says):
    asked = query.format(**vars(known))
    refused = analyst.get(f"{PAGE}?{asked}")
    assert (refused.status_code, says in refused.text) == (status, True)
    assert analyst.get(f"{PAGE}/flow_field.png?{asked}").status_code == 404


def test_figures_of_quarantined_policies_are_not_handed_out_and_strangers_see_none(analyst, services, known):
    asked = f"?policy_a={known.lost}&scene=3500000000"
    assert analyst.get(f"{PAGE}/flow_field.png{asked}").status_code == 200
    assert analyst.get(f"{PAGE}/another.png{asked}").status_code == 404
    with services.database.transaction() as s:
        s.get_one(Artefact, known.lost).quarantined_at = utc_now()
    assert analyst.get(f"{PAGE}/flow_field.png{asked}").status_code == 410
    assert analyst.get(f"{PAGE}{asked}").status_code == 410
    assert ">study_room/ensemble/0<" not in analyst.get(PAGE).text
    assert ">study_room/ensemble/1<" in analyst.get(PAGE).text
    with TestClient(create_application(services), follow_redirects=False) as stranger:
        for address in (PAGE, f"{PAGE}/flow_field.png?policy_a={known.base}"):
            assert stranger.get(address).headers["location"].startswith("/lab/sign-in")


def test_drawing_process_survives_a_bad_order_and_is_replaced_when_it_dies():
    process = FigureProcess()
    policy = (("study_room/base", load_policy("study_room/base").without_critic().to_bytes()),)
    try:
        with pytest.raises(FigureError, match="at least"):
            process.draw(FlowOrder(policy, 1, 0.001, ()))
        first, made = process.draw(FlowOrder(policy, 1, 1.0, ()))
        assert process.draw(FlowOrder(policy, 1, 1.0, ()))[1] is made
        process.child.kill()
        process.child.wait()
        second, other = process.draw(FlowOrder(policy, 2, 1.0, (("x", "across"),)))
        assert first != second
        assert made.files["flow_field.csv"] != other.files["flow_field.csv"]
    finally:
        process.close()
