"""A lab brings its setup on the page: checked, drawn, trained by a job, taken away, removed; what is wrong is said."""

from __future__ import annotations

import hashlib
import io
import json
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import select

from desirepath.installed import ROOT
from desirepath.jobs.kinds import get_kind
from desirepath.learning.policies.policy import Policy
from desirepath.learning.policies.shape import NetworkShape
from desirepath.learning.shipped_files import resolve
from desirepath.learning.shipping.brought_back import bring_back
from desirepath.learning.shipping.own_setup import DEFINITION, description_sha256
from desirepath.learning.shipping.storing import Request
from desirepath.simulation.setup_intake import CHECKED, unpack
from desirepath.simulation.setups import get_setup, own_setups, tell_changed, uploaded_setups
from desirepath.store.models import Artefact, Job, StudyRole
from desirepath.store.outbox import enqueue_job
from desirepath.study.studies import create_study
from desirepath.web.core.guard import LARGER
from tests.simulation.test_ground_maps import draw_map
from tests.simulation.test_setup_intake import zipped
from tests.study.small_protocol import small_protocol
from tests.web.lab_services import csrf

PAGE = "/lab/settings/setups"


@pytest.fixture(autouse=True)
def own_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The setups of this installation lie in a folder of the test."""
    monkeypatch.setenv("DESIREPATH_DATA", str(tmp_path / "data"))
    monkeypatch.delenv("DESIREPATH_SETUPS", raising=False)


def bring(lab, tmp_path: Path, name: str = "our_lab", robot: str = "turtlebot3_burger", **changed: bytes):
    (tmp_path / "brought").mkdir(exist_ok=True)
    draw_map(tmp_path / "brought")
    given = {file.name: file.read_bytes() for file in (tmp_path / "brought").iterdir()} | {
        name.replace("_yaml", ".yaml"): content for name, content in changed.items()
    }
    files = [("files", (one, content)) for one, content in given.items()]
    form = {"csrf": csrf(lab, PAGE), "name": name, "robot": robot}
    return lab.post(PAGE, data=form, files=files, follow_redirects=False)


def test_a_setup_is_brought_drawn_trained_taken_and_removed(lab, lab_services, tmp_path):
    assert "No setup of your own yet." in lab.get(PAGE).text
    assert bring(lab, tmp_path).headers["location"] == f"{PAGE}?done=setup_brought#our_lab"
    page = lab.get(f"{PAGE}?done=setup_brought").text
    for said in (
        "our_lab",
        "turtlebot3_burger",
        "8.1 × 6.1 m",
        "nothing yet",
        "m² in reach",
        "Train it, so that studies can use it.",
    ):
        assert said in page
    picture = lab.get(f"{PAGE}/our_lab/picture.png")
    assert (picture.status_code, picture.headers["content-type"]) == (200, "image/png")
    assert set(unpack("x.zip", io.BytesIO(lab.get(f"{PAGE}/our_lab/setup.zip").content))) == {
        "map.pgm",
        "map.yaml",
        "setup.yaml",
        CHECKED,
    }

    started = [
        lab.post(f"{PAGE}/our_lab/train", data={"csrf": csrf(lab, PAGE)}, follow_redirects=False).headers["location"]
        for _ in range(2)
    ]
    assert started[0] == started[1]  # it is under way: no second one
    with lab_services.database.session() as s:
        (job,) = s.scalars(select(Job).where(Job.kind == "train_setup"))
    assert get_kind(job.kind).parse(job.params).setup == "our_lab"
    assert "queued" in lab.get(PAGE).text
    assert "Train a setup" in lab.get(started[0]).text
    assert "our_lab" in lab.get("/lab/jobs/new/train_setup").text

    refused = lab.post(f"{PAGE}/our_lab/remove", data={"csrf": csrf(lab, PAGE)})
    assert refused.status_code == 409  # its training is under way
    assert f"job {job.id}" in refused.text
    with lab_services.database.transaction() as s:
        s.get_one(Job, job.id).state = "cancelled"
    removed = lab.post(f"{PAGE}/our_lab/remove", data={"csrf": csrf(lab, PAGE)}, follow_redirects=False)
    assert removed.headers["location"] == f"{PAGE}?done=setup_removed"
    assert own_setups() == ()
    assert list(uploaded_setups().iterdir()) == []


def test_a_setup_that_something_stands_on_is_not_removed(lab, lab_services, tmp_path):
    assert bring(lab, tmp_path, "study").status_code == 303  # a word of every protocol: no use
    assert bring(lab, tmp_path).status_code == 303
    with lab_services.database.transaction() as s:
        s.add(Artefact(id="a" * 64, kind="policy", name="our_lab/base", setup="our_lab", card={}))
        (tmp_path / "protocol").mkdir()
        block = {"block": {"view": "top_down", "trials": [{"queries": {"count": 2}}]}}
        frozen = small_protocol(tmp_path / "protocol", [block])
        study = create_study(s, lab_services.files, frozen, name="Ours", created_by=None)
        study.protocol = study.protocol | {"steps": [{"tuning": {"setup": "our_lab"}}]}
    refused = lab.post(f"{PAGE}/our_lab/remove", data={"csrf": csrf(lab, PAGE)})
    assert refused.status_code == 409
    assert "study “Ours”, our_lab/base" in refused.text
    page = lab.get(PAGE).text
    assert 'action="/lab/settings/setups/our_lab/remove"' not in page
    assert 'action="/lab/settings/setups/study/remove"' in page
    answered = lab.post(f"{PAGE}/study/remove", data={"csrf": csrf(lab, PAGE)}, follow_redirects=False)
    assert answered.status_code == 303


def untrained(folder: Path, noise: float = 0.0) -> bytes:
    """A policy of the setup in that folder, as training puts it there; its file."""
    setup = get_setup(folder.name)
    shape = NetworkShape(setup.polar_size, setup.surroundings_size, 4, (8,))
    sizes = [size for inputs, outputs in shape.actor_layers() for size in ((inputs, outputs), (outputs,))]
    actor = tuple(np.full(size, noise, dtype=np.float32) for size in sizes)
    made_of = {DEFINITION: description_sha256(folder)}
    request = Request(folder.name, folder=folder.parent, made_of=made_of, command="desirepath setups train our_lab")
    request.store("policy", "base", Policy(folder.name, shape, actor).save, "base")
    return (folder / "base.npz").read_bytes()


def zip_out(lab) -> dict[str, bytes]:
    return unpack("x.zip", io.BytesIO(lab.get(f"{PAGE}/our_lab/setup.zip").content))


def test_a_trained_setup_comes_back_with_what_was_trained_in_it(lab, lab_services, tmp_path):
    bring(lab, tmp_path)
    folder = uploaded_setups() / "our_lab"
    policy = untrained(folder)
    (folder / ".training").mkdir()
    (folder / ".training/our_lab_base.npz").write_bytes(b"on its way")
    out = zip_out(lab)
    assert set(out) == {"map.pgm", "map.yaml", "setup.yaml", "base.npz", "base.card.json", CHECKED}
    assert lab.post(f"{PAGE}/our_lab/remove", data={"csrf": csrf(lab, PAGE)}).status_code == 303
    form = {"csrf": csrf(lab, PAGE), "name": "our_lab"}
    assert lab.post(PAGE, data=form, files=[("files", ("x.zip", zipped(out)))]).status_code == 303
    assert (folder / "base.npz").read_bytes() == policy
    page = lab.get(PAGE).text
    assert "Left out" not in page
    assert "<dd>base</dd>" in page
    assert 'our_lab/base</a> <span class="tag">brought or made by command</span>' in lab.get("/lab/policies").text
    with lab_services.database.session() as s:
        assert s.scalars(select(Artefact.kind).where(Artefact.name == "our_lab/base")).one() == "policy"

    form["name"] = "their_lab"
    assert lab.post(PAGE, data=form, files=[("files", ("x.zip", zipped(out)))]).status_code == 303
    assert "its card says policy our_lab/base; bring it back under its setup&#39;s name" in lab.get(PAGE).text
    assert not (uploaded_setups() / "their_lab/base.npz").exists()


def test_what_is_not_as_training_left_it_is_left_out_and_told(lab, tmp_path):
    bring(lab, tmp_path)
    folder = uploaded_setups() / "our_lab"
    other = untrained(folder, 0.1)
    untrained(folder)
    out = zip_out(lab)
    for file in ("base.npz", "base.card.json"):
        (folder / file).unlink()
    card = json.loads(out["base.card.json"])
    pickled = io.BytesIO()
    np.savez(pickled, allow_pickle=True, meta=np.array([{}], dtype=object))

    def with_card(content: bytes, **changed: object) -> dict[str, bytes]:
        described = card | {"sha256": hashlib.sha256(content).hexdigest()} | changed
        return {"base.npz": content, "base.card.json": json.dumps(described).encode()}

    for files, why in (
        ({"base.npz": out["base.npz"]}, "has no card"),
        ({"base.card.json": out["base.card.json"]}, "base.npz is not among the files"),
        ({"base.npz": other, "base.card.json": out["base.card.json"]}, "file and card disagree"),
        ({"base.npz": other, "base.card.json": b"[" * 100_000}, "is incomplete or no card"),
        (with_card(out["base.npz"], seed="none"), "is incomplete or no card"),
        (with_card(out["base.npz"], results={"first": float("nan")}), "is incomplete or no card"),
        (with_card(out["base.npz"], notes=["\0"]), "NUL characters"),
        (with_card(out["base.npz"], parents={DEFINITION: "0" * 64}), "another description of the setup"),
        (with_card(out["base.npz"], parents=card["parents"] | {"our_lab/base0": "0" * 64}), "of other policies"),
        (with_card(pickled.getvalue()), "base.npz: "),
        (with_card(resolve("study_room/base").read_bytes()), "is of setup study_room"),
        ({"../base.npz": other, "../base.card.json": b""}, "is nothing that training a setup makes"),
    ):
        kept, left_out = bring_back(folder, files)
        assert (kept, len(left_out)) == ([], 1)
        assert why in left_out[0]
        assert not list(tmp_path.rglob("base.*"))
    assert bring_back(folder, with_card(out["base.npz"])) == (["our_lab/base"], [])


def test_a_broken_setup_is_listed_with_its_error_and_removed(lab, tmp_path):
    bring(lab, tmp_path)
    (uploaded_setups() / "our_lab/setup.yaml").write_text("robots: turtlebot2\n")
    tell_changed()
    page = lab.get(PAGE).text
    assert "did you mean robot" in page
    assert lab.get("/lab/jobs/new/train_base").status_code == 200
    lab.post(f"{PAGE}/our_lab/remove", data={"csrf": csrf(lab, PAGE)})
    assert list(uploaded_setups().iterdir()) == []


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"name": "study_room"}, "there is a setup of this name"),
        ({"robot": ""}, "no setup.yaml and no robot.yaml"),
        ({"map_yaml": b"image: map.pgm\nresolution: 0.05\n"}, "map.yaml:1: origin: is missing"),
        ({"map_yaml": b"image: gone.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n"}, "gone.pgm"),
        ({"setup_yaml": b"robot: turtlebot2\nworld: {name: bilding}\n"}, "did you mean building"),
    ],
)
def test_what_is_wrong_is_said_as_by_the_command_and_nothing_is_kept(lab, tmp_path, given, says):
    answered = bring(lab, tmp_path, **given)
    assert answered.status_code == 422
    assert says in answered.text.replace("&#39;", "'")
    assert own_setups() == ()


def test_more_than_is_taken_is_refused_before_it_is_read(lab, tmp_path):
    form = {"csrf": csrf(lab, PAGE), "name": "our_lab"}
    much = [("files", ("map.pgm", bytes(67 * 1024**2)))]
    assert lab.post(PAGE, data=form, files=much).status_code == 413
    assert lab.post(PAGE, data=form, files=[("files", ("x.zip", b"PK nothing"))]).status_code == 422
    zips = [("files", (f"{k}.zip", zipped({f"{k}.stl": bytes(16 * 1024**2)}))) for k in range(5)]
    refused = lab.post(PAGE, data=form, files=zips)
    assert refused.status_code == 422
    assert "4.stl makes it too large" in refused.text
    assert own_setups() == ()


def test_the_server_before_ours_lets_through_what_the_page_takes():
    caddy = (ROOT / "deploy/Caddyfile").read_text()
    for path in (path for path, size in LARGER.items() if size > 25e6):
        assert f"path {path}\n" in caddy
    assert "max_size 70MB" in caddy


def test_who_may_only_look_brings_trains_and_removes_nothing(lab, as_role, tmp_path):
    bring(lab, tmp_path)
    viewer = as_role("viewer")
    page = viewer.get(PAGE).text
    assert "our_lab" in page
    assert "Check and save" not in page
    token = csrf(viewer, "/lab/studies")
    for path in (PAGE, f"{PAGE}/our_lab/train", f"{PAGE}/our_lab/remove"):
        assert viewer.post(path, data={"csrf": token, "name": "x"}).status_code == 403
    assert viewer.get(f"{PAGE}/our_lab/setup.zip").status_code == 403
    assert own_setups() == ("our_lab",)


def test_a_role_in_single_studies_brings_trains_takes_and_removes_none(lab, lab_services, colleague, as_role, tmp_path):
    """Setups belong to the installation."""
    bring(lab, tmp_path)
    member = colleague("member", "analyst", "owner")
    page = member.get(PAGE).text
    assert "our_lab" in page
    for offered in ("Check and save", "our_lab/train", "our_lab/setup.zip", "our_lab/remove"):
        assert offered not in page
    token = csrf(member)
    for path in (PAGE, f"{PAGE}/our_lab/train", f"{PAGE}/our_lab/remove", "/lab/jobs/new/train_setup"):
        assert member.post(path, data={"csrf": token, "name": "x", "setup": "our_lab"}).status_code == 403, path
    for path in (f"{PAGE}/our_lab/setup.zip", "/lab/jobs/new/train_setup"):
        assert member.get(path).status_code == 403
    assert "train_setup" not in member.get("/lab/jobs/new").text
    with lab_services.database.transaction() as s:
        study = s.scalars(select(StudyRole.study_id)).first()
        old = enqueue_job(s, "train_setup", {"setup": "our_lab"}, study_id=study)
        old.state = "cancelled"
    assert member.post(f"/lab/jobs/{old.id}/retry", data={"csrf": token}).status_code == 403
    analyst = as_role("analyst")
    assert analyst.get(f"{PAGE}/our_lab/setup.zip").status_code == 200
    assert analyst.post(f"{PAGE}/our_lab/train", data={"csrf": csrf(analyst)}).status_code == 303


def test_only_own_setups_are_taken_trained_or_removed(lab):
    for path in ("train", "remove"):
        assert lab.post(f"{PAGE}/study_room/{path}", data={"csrf": csrf(lab, PAGE)}).status_code == 404
    assert lab.get(f"{PAGE}/study_room/setup.zip").status_code == 404
