"""An analyst's own policy on the page: taken in, shown as imported, used like any other, deleted; what cannot be is
refused."""

from __future__ import annotations

import io
import json

import pytest
from sqlalchemy import select

from desirepath.learning.policies.export import policy_to_onnx
from desirepath.learning.policies.policy import read_policy
from desirepath.learning.policies.shipped import load_policy
from desirepath.store.models import Artefact, Audit
from desirepath.store.shipped_policies import register_shipped
from desirepath.web.analyst.policy_files import LARGEST_FILE
from tests.learning.test_importing import LAYERS, MANIFEST, PARAMETERS, graph, saved, sb3
from tests.web.lab_services import csrf


def take_in(lab, content: bytes, file: str = "other.onnx", manifest: bytes | None = None, **form: str):
    files = {"policy": (file, io.BytesIO(content), "application/octet-stream")}
    if manifest is not None:
        files["manifest"] = ("manifest.json", io.BytesIO(manifest), "application/json")
    return lab.post(
        "/lab/policy-files", data={"csrf": csrf(lab, "/lab/policies"), **form}, files=files, follow_redirects=False
    )


@pytest.mark.parametrize("language", ["en", "de"])
def test_a_policy_of_ones_own_is_taken_in_listed_and_used_like_any_other(lab, lab_services, language):
    lab.headers["Accept-Language"] = language
    taken = take_in(lab, graph(LAYERS, PARAMETERS), name="from the other lab")
    assert taken.status_code == 303, taken.text
    page = lab.get(taken.headers["location"]).text
    assert {"en": "imported", "de": "importiert"}[language] in page
    assert "from the other lab" in page
    assert "other.onnx" in page
    policy = taken.headers["location"].rpartition("/")[2]
    assert "from the other lab" in lab.get("/lab/policies").text
    for form in ("evaluate", "compare", "queries"):
        assert f'value="{policy}"' in lab.get(f"/lab/jobs/new/{form}").text
    for drawn in ("flow-field", "explain"):
        page = lab.get(f"/lab/{drawn}?policy_a={policy}", follow_redirects=True)
        assert 'value="from the other lab" selected' in page.text
        assert page.url.params["policy"] == "from the other lab"
    assert lab.get(f"/lab/policies/{policy}/policy.onnx").status_code == 200
    assert lab.get(f"/lab/policies/{policy}/policy.zip").status_code == 200
    with lab_services.database.session() as s:
        kept = s.get_one(Artefact, policy)
        assert (kept.kind, kept.setup) == ("policy", "study_room")
        assert kept.card["imported"]["by"]
        noted = s.scalars(select(Audit).where(Audit.action == "policy_taken_in")).all()
        assert noted[-1].data["artefact"] == policy
        stored = lab_services.files.get(policy)
    assert read_policy(stored).driving().setup == "study_room"
    deleted = lab.post(
        f"/lab/artefacts/{policy}/delete",
        data={"csrf": csrf(lab, f"/lab/artefacts/{policy}/upkeep"), "typed": "from the other lab"},
        follow_redirects=False,
    )
    assert deleted.status_code == 303, deleted.text
    assert not lab_services.files.exists(policy)


def test_a_zip_of_stable_baselines3_and_a_manifest_beside_are_taken_in(lab):
    assert take_in(lab, saved(sb3()), "model.zip", setup="study_room").status_code == 303
    bare = graph(LAYERS, PARAMETERS, manifest=None)
    assert take_in(lab, bare, manifest=json.dumps(MANIFEST).encode()).status_code == 303


def test_the_download_of_a_policy_comes_back(lab, lab_services):
    with lab_services.database.transaction() as s:
        register_shipped(s, lab_services.files)
    taken = take_in(lab, policy_to_onnx(load_policy("study_room/base")), "downloaded.onnx")
    assert taken.status_code == 303, taken.text
    page = lab.get(taken.headers["location"]).text
    assert "study_room/base" in page  # in its lineage


@pytest.mark.parametrize(
    ("content", "name", "more", "why"),
    [
        (b"no network", "other.onnx", {}, "no ONNX file"),
        (b"PK", "model.zip", {"setup": "study_room"}, "no zip that can be read"),
        (b"PK", "model.zip", {"setup": "the moon"}, "the moon"),
        (b"x", "policy.pt", {}, "must end with one of"),
        (b"x" * (LARGEST_FILE + 1), "other.onnx", {}, "MB"),
        (graph(LAYERS, PARAMETERS, MANIFEST | {"control_rate_hz": 20}), "other.onnx", {}, "control_rate_hz"),
    ],
)
def test_what_cannot_be_taken_in_says_why_and_nothing_is_kept(lab, lab_services, content, name, more, why):
    refused = take_in(lab, content, name, **more)
    assert refused.status_code == 422
    assert why in refused.text
    with lab_services.database.session() as s:
        assert [one for one in s.scalars(select(Artefact)) if "imported" in one.card] == []


def test_who_may_start_no_jobs_takes_nothing_in(lab_services, colleague):
    viewer = colleague("viewer")
    refused = viewer.post("/lab/policy-files", data={"csrf": csrf(viewer)}, follow_redirects=False)
    assert refused.status_code == 403
    assert "/lab/policy-files" not in viewer.get("/lab/policies").text
