"""A robot of a study over real HTTP: it hears what it is to do, drives, is mirrored, and hands in its recording."""

from __future__ import annotations

import asyncio
import html
import json
import threading
from contextlib import suppress
from uuid import uuid4

import httpx
import pytest
from fastapi.testclient import TestClient
from sqlalchemy import select, update

from desirepath.deploy.link import Link, LinkError
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.dataset.importing import import_dataset
from desirepath.store.dataset.writing import export_study
from desirepath.store.erasure import erase_participant
from desirepath.store.models import Participant, Response, RobotRun, StudyRobot, User
from desirepath.study import robots
from desirepath.study.refusals import Refused
from desirepath.web.application import create_application
from desirepath.web.core.auth import add_user
from desirepath.web.core.throttle import LARGEST_RECORDING, REQUESTS_PER_ROBOT
from desirepath.web.robot.mirror import MOST_LISTENERS
from desirepath.web.robot.robot_requests import MAGIC
from tests.running import until
from tests.web.lab_services import csrf, sign_in
from tests.web.robot_services import RobotLab, bearer

STATE = {"run": None, "state": "armed", "pose": [0, 0, 0], "speed": [0, 0]}


def the_run(at: RobotLab) -> RobotRun:
    with at.services.database.session() as s:
        return s.scalars(select(RobotRun).order_by(RobotRun.created_at.desc())).first()


def test_a_robot_drives_for_somebody_hears_new_weights_is_mirrored_and_recorded(robot_lab, turtle, tmp_path):
    turtle.period_s = 0.2  # as a real one
    somebody = robot_lab.somebody()
    until(lambda: turtle.link.orders.run is not None, "it stands ready for whoever waits")
    waiting = turtle.link.orders
    with robot_lab.services.database.session() as s:
        robot = s.scalars(select(StudyRobot)).one()
    assert (waiting.drive, waiting.setup) == (False, "study_room")
    assert sum(waiting.weights.values()) > 0, "as learned from the answers"
    here = f"{robot_lab.url}/api/session/{somebody.token}"
    session = httpx.Client(timeout=30)
    assert session.get(here).json()["step"]["trial"]["phase"] == "waiting"
    assert session.get(here).json()["step"]["trial"]["robot"] == "Turtle"

    mirrored: list[dict] = []

    def watch() -> None:
        broken_off = suppress(httpx.RemoteProtocolError)  # by the server's end
        with broken_off, session.stream("GET", f"{here}/robot/robot_drive/stream") as stream:
            for line in stream.iter_lines():
                if line.startswith("data: {") and len(line) > 10:
                    mirrored.append(json.loads(line[6:]))

    threading.Thread(target=watch, daemon=True).start()
    assert robot_lab.press(f"{robot.id}/drive", run=waiting.run).status_code == 303
    until(lambda: turtle.link.orders.drive, "the experimenter's button starts it")
    until(lambda: session.get(here).json()["step"]["trial"]["phase"] == "driving", "phase driving")
    until(
        lambda: any(said["state"] == "driving" and said["plan"] and said["scan"] for said in mirrored),
        f"mirrored: {mirrored[-1:]}",
    )

    told = session.post(f"{here}/robot/robot_drive/weights", json={"weights": {"farther": 0.9, "smoother": 0.3}})
    assert told.status_code == 204, told.text
    until(lambda: (turtle.link.orders.weights or {}).get("farther") == 0.9)
    until(lambda: mirrored[-1]["weights"] == {"farther": 0.9, "smoother": 0.3}, "and says that it drives by them")
    assert session.post(f"{here}/robot/robot_drive/person", json={"place": [2.0, 1.0]}).status_code == 204
    until(lambda: turtle.link.orders.person == (2.0, 1.0))
    too_early = session.post(
        f"{here}/steps/robot_drive", json={"request_id": uuid4().hex, "value": {"weights": {}, "liked": 5}}
    )
    assert too_early.json()["error"]["code"] == "still_driving"

    turtle.period_s = 0.01
    until(lambda: turtle.handed_in, "it comes to its goal and hands in its recording")
    until(lambda: session.get(here).json()["step"]["trial"]["phase"] == "over")
    run = the_run(robot_lab)
    assert run.summary["reached"]
    assert run.summary["way_m"] > 2
    assert run.recording == turtle.handed_in[0]
    assert run.moved_at is not None
    told = session.get(here).json()["step"]["trial"]
    assert told["answers"] == 2
    assert told["wheels_after_s"] == pytest.approx((run.moved_at - run.asked_at).total_seconds(), abs=0.01)
    start = dict(run.weights)
    answered = session.post(
        f"{here}/steps/robot_drive", json={"request_id": uuid4().hex, "value": {"weights": waiting.weights, "liked": 6}}
    )
    assert answered.json().get("accepted"), (answered.text, start)


# ---- who may, and how much -------------------------------------------------------------------------------------------


def started(at: RobotLab, token: str) -> str:
    """A run that this robot drives."""
    at.somebody()
    run = at.orders(token)["run"]
    with at.services.database.transaction() as s:
        found = s.get_one(RobotRun, run)
        robots.start_run(s, found, "experimenter", found.created_at)
    return run


def ask(at: RobotLab, method: str, path: str, token: str, **more) -> httpx.Response:
    return httpx.request(method, f"{at.url}/api/robot{path}", headers=bearer(token), timeout=30, **more)


ROUTES = [
    ("GET", ""),
    ("GET", "/orders?wait=0"),
    ("GET", "/bundle"),
    ("POST", "/state"),
    ("POST", "/over"),
    ("POST", "/recording?run=x"),
]


def test_no_route_opens_without_a_token_that_counts_and_many_tries_are_turned_away(robot_lab):
    token = robot_lab.admit()
    with robot_lab.services.database.session() as s:
        robot = s.scalars(select(StudyRobot)).one()
    assert token not in (robot.token_hash, robot.id), "what is stored does not open"
    over = {"run": "x", "driven_s": 1, "way_m": 1, "reached": True}
    bodies = {"/state": {"json": STATE}, "/over": {"json": over}}
    file = {"content": b"x", "headers": {"Content-Type": "application/octet-stream"}}
    for method, path in ROUTES:
        for sent in ({}, {"Authorization": "Bearer"}, bearer(token[:-1]), bearer(robot.token_hash), bearer(robot.id)):
            more = dict(bodies.get(path, file if "recording" in path else {}))
            more["headers"] = {**more.get("headers", {}), **sent}
            answered = httpx.request(method, f"{robot_lab.url}/api/robot{path}", **more)
            assert answered.status_code == 401, (path, sent, answered.text)
    assert robot_lab.press(f"{robot.id}/revoke").status_code == 303
    assert ask(robot_lab, "GET", "", token).status_code == 401, "its access was ended"
    tries = [ask(robot_lab, "GET", "", "guess").status_code for _ in range(60)]
    assert tries[-1] == 429
    assert ask(robot_lab, "GET", "", robot_lab.admit("Second")).status_code == 200, "who has one is let in all the same"


def test_a_robot_reaches_its_own_study_and_its_own_runs_alone(robot_lab):
    mine, others = robot_lab.admit(), robot_lab.admit("Stranger", study=robot_lab.others)
    run = started(robot_lab, mine)
    with robot_lab.services.database.session() as s:
        code = s.scalars(select(Participant.code)).one()
    assert robot_lab.orders(others)["run"] is None
    assert ask(robot_lab, "GET", f"/bundle?participant={code}", others).status_code == 404
    over = {"run": run, "driven_s": 1, "way_m": 1, "reached": True}
    assert ask(robot_lab, "POST", "/over", others, json=over).status_code == 404
    file = {"content": MAGIC * 2, "headers": {**bearer(others), "Content-Type": "application/octet-stream"}}
    assert httpx.post(f"{robot_lab.url}/api/robot/recording?run={run}", **file).status_code == 404
    forged = STATE | {"run": run, "state": "driving", "speed": [0.5, 0.0]}
    assert ask(robot_lab, "POST", "/state", others, json=forged).status_code == 204
    assert the_run(robot_lab).moved_at is None, "another robot cannot say that this one drives"
    with robot_lab.services.database.session() as s:
        watched = {robot.name: robot.id for robot in s.scalars(select(StudyRobot))}
    assert robot_lab.services.mirror.latest(watched["Turtle"]) is None
    assert robot_lab.services.mirror.latest(watched["Stranger"])["run"] is None
    assert ask(robot_lab, "POST", "/state", mine, json=forged).status_code == 204
    assert the_run(robot_lab).moved_at is not None
    page = f"/lab/studies/{robot_lab.others}/robots/{watched['Turtle']}"
    assert robot_lab.lab.get(page).status_code == 404, "nor is it a robot of the other study's pages"


def test_another_participant_sees_and_steers_no_foreign_drive(robot_lab):
    token = robot_lab.admit()
    run = started(robot_lab, token)
    other = robot_lab.somebody()
    here = f"{robot_lab.url}/api/session/{other.token}/robot/robot_drive"
    assert httpx.get(f"{here}/stream").json()["error"]["code"] == "no_robot", "it is busy, so nothing is mirrored"
    assert httpx.post(f"{here}/person", json={"place": [1, 1]}).status_code == 409
    assert httpx.post(f"{here}/stop", json={}).status_code == 409
    before = robot_lab.orders(token)
    assert httpx.post(f"{here}/weights", json={"weights": {"farther": 1.0}}).status_code == 204, "kept for their own"
    assert robot_lab.orders(token) == before
    assert before["run"] == run
    wrong = httpx.post(f"{here}/weights", json={"weights": {"farther": 0.5, "closer": 0.5}}).json()["error"]
    assert wrong["field"] == "weights.farther"
    assert "opposite" in wrong["message"]


TOO_MUCH = {
    "pose": {"pose": [0, 0]},
    "pose.2": {"pose": [0, 0, 1e9]},
    "scan": {"scan": [[0, 0]] * 121},
    "scan.0.1": {"scan": [[0, "far"]]},
    "plan": {"plan": [[0, 0]] * 41},
    "people": {"people": [[0, 0]] * 21},
    "reason": {"reason": "x" * 121},
    "state": {"state": "flying"},
    "speed.0": {"speed": [None, 0]},
}


def test_what_is_said_is_bounded_field_by_field(robot_lab):
    token = robot_lab.admit()
    for field, change in TOO_MUCH.items():
        wrong = ask(robot_lab, "POST", "/state", token, json=STATE | change)
        assert (wrong.status_code, wrong.json()["error"]["field"]) == (422, field)


def test_floods_and_huge_bodies_are_refused_before_they_are_read(robot_lab):
    token = robot_lab.admit()
    huge = STATE | {"more": "x" * 300_000}
    assert ask(robot_lab, "POST", "/state", token, json=huge).status_code == 413
    run = started(robot_lab, token)
    client = TestClient(create_application(robot_lab.services))
    at, kind = f"/api/robot/recording?run={run}", {"Content-Type": "application/octet-stream"}
    told = {"Content-Length": str(LARGEST_RECORDING + 1)}
    assert client.post(at, content=b"x", headers=bearer(token) | kind | told).status_code == 413

    def endless():
        for _ in range(LARGEST_RECORDING // 2**20 + 2):
            yield b"x" * 2**20

    assert client.post(at, content=endless(), headers=bearer(token) | kind).status_code == 413
    assert client.post(at, content=b"no mcap", headers=bearer(token) | kind).json()["error"]["field"] == "body"
    assert client.post(at, content=b"{}", headers=bearer(token)).status_code == 415
    assert client.post(at, content=MAGIC * 2, headers=bearer(token) | kind).status_code == 200
    again = client.post(at, content=MAGIC * 3, headers=bearer(token) | kind)
    assert again.json()["error"]["code"] == "recorded", "what is kept is not written over"
    with robot_lab.services.database.session() as s:
        robot = s.scalars(select(StudyRobot)).one()
    while robot_lab.services.limiter.hit(REQUESTS_PER_ROBOT, "robot", robot.id):
        pass
    assert ask(robot_lab, "GET", "", token).status_code == 429, "whoever asks all the time is told to wait"


def test_a_robot_does_not_wait_in_any_number_of_places(robot_lab):
    token = robot_lab.admit()
    with robot_lab.services.database.session() as s:
        key = f"orders {s.scalars(select(StudyRobot)).one().id}"

    async def fill() -> None:
        for _ in range(MOST_LISTENERS):
            robot_lab.services.mirror.listen(key)
        with pytest.raises(Refused, match="too many places"):
            robot_lab.services.mirror.listen(key)

    asyncio.run(fill())
    number = robot_lab.orders(token)["number"]
    assert ask(robot_lab, "GET", f"/orders?after={number}&wait=5", token).status_code == 429


def test_only_who_runs_the_study_lets_robots_in_drives_them_or_takes_recordings(robot_lab):
    token = robot_lab.admit()
    run = started(robot_lab, token)
    password = add_user(robot_lab.services.database, "looker", "viewer")
    with robot_lab.services.database.transaction() as s:
        robot = s.scalars(select(StudyRobot)).one()
        s.execute(update(User).where(User.name == "looker").values(must_change_password=False))
    with httpx.Client(base_url=robot_lab.url) as looker:
        sign_in(looker, "looker", password)
        page = f"/lab/studies/{robot_lab.study}/robots"
        assert looker.get(f"{page}/{robot.id}").status_code == 200, "may look"
        given = csrf(looker)
        for path in ("", f"/{robot.id}/drive", f"/{robot.id}/stop", f"/{robot.id}/revoke"):
            assert looker.post(f"{page}{path}", data={"csrf": given, "name": "x"}).status_code == 403, path
        api = f"/api{page}/{robot.id}"
        for path, body in (("weights", {"weights": {}}), ("person", {"place": [0, 0]}), ("words", {"sentence": "x"})):
            assert looker.post(f"{api}/{path}", json=body, headers={"X-CSRF": given}).status_code == 403, path
        assert looker.get(f"/lab/studies/{robot_lab.study}/robot-runs/{run}.mcap").status_code == 403
    for path, body in (("weights", {"weights": {}}), ("person", {"place": [0, 0]})):
        assert robot_lab.lab.post(f"{api}/{path}", json=body).status_code == 403, "not without the page's token"


def test_the_labs_page_has_the_steps_controls_a_triangle_and_sentences(robot_lab):
    robot = robot_lab.admit_id(robot_lab.admit())
    page, api = (f"{at}/lab/studies/{robot_lab.study}/robots/{robot}" for at in ("", "/api"))
    plain = robot_lab.lab.get(page).text
    assert "data-ends" in plain
    assert "data-triangle" not in plain
    three = "?corner=farther&corner=smoother&corner=faster"
    assert 'data-triangle="farther smoother faster"' in robot_lab.lab.get(page + three).text
    started = robot_lab.press(f"{robot}/drive{three}", setup="study_room", x="2", y="0")
    assert started.headers["location"] == page + three, "the triangle stays"
    wall = "[[[4.2, 5.7], [4.2, -5.7], [4.0, -5.7], [4.0, 5.7]]"
    assert wall in html.unescape(robot_lab.lab.get(page).text), "the walls of the setup's room"
    opposed = robot_lab.lab.get(f"{page}?corner=farther&corner=closer&corner=faster")
    assert "no two of them opposites" in opposed.text
    given = {"X-CSRF": csrf(robot_lab.lab, page)}
    read = robot_lab.lab.post(f"{api}/words", json={"sentence": "keep well away from me"}, headers=given)
    assert read.json()["weights"]["farther"] > 0


# ---- a run's end -----------------------------------------------------------------------------------------------------


def test_what_a_robot_drove_is_exported_imported_and_erased_with_the_person(robot_lab, tmp_path):
    token = robot_lab.admit()
    robot = robot_lab.admit_id(token)
    somebody = robot_lab.somebody()
    run = robot_lab.orders(token)["run"]
    assert robot_lab.press(f"{robot}/drive", run=run).status_code == 303
    link = Link(robot_lab.url, token)
    sha = link.over(run, driven_s=3, way_m=1.5, reached=False, stops=[(3.0, "stop topic")], recording=MAGIC * 2)
    files, database = robot_lab.services.files, robot_lab.services.database
    assert files.exists(sha)
    weights = the_run(robot_lab).weights
    somebody.submit("robot_drive", {"weights": weights, "liked": 2})
    with database.session() as s:
        value = s.scalars(select(Response).where(Response.kind == "robot_drive")).one().value
    assert (value["recording"], value["driven_s"], value["liked"], value["learned_from"]) == (sha, 3.0, 2, 2)
    assert value["stops"] == [{"at_s": 3.0, "reason": "stop topic"}]
    taken = robot_lab.lab.get(f"/lab/studies/{robot_lab.study}/robot-runs/{run}.mcap")
    assert taken.content == MAGIC * 2

    export_study(database, files, robot_lab.study, tmp_path / "out")
    assert (tmp_path / "out" / "recordings" / f"{sha}.mcap").read_bytes() == MAGIC * 2
    other = Database(f"sqlite:///{tmp_path / 'other.sqlite'}")
    other.migrate()
    elsewhere = ArtefactStore((tmp_path / "files").as_uri())
    import_dataset(other, elsewhere, tmp_path / "out")
    assert elsewhere.get(sha) == MAGIC * 2
    other.close()

    with database.session() as s:
        person = s.scalars(select(Participant.id)).one()
    erased = erase_participant(database, files, person, "experimenter", data=robot_lab.services.settings.data)
    assert erased["counts"]["recordings"] == 1
    assert not files.exists(sha)
    assert the_run(robot_lab) is None


def test_who_leaves_stops_the_robot_and_no_robot_waits_for_ever(robot_lab, turtle):
    turtle.period_s = 0.1
    somebody = robot_lab.somebody()
    until(lambda: turtle.link.orders.run)
    with robot_lab.services.database.session() as s:
        robot = s.scalars(select(StudyRobot)).one().id
    robot_lab.press(f"{robot}/drive", run=turtle.link.orders.run)
    until(
        lambda: any(orders.drive for _, orders in turtle.heard), "it heard that it may drive, before it hears no more"
    )
    assert httpx.post(f"{robot_lab.url}/api/session/{somebody.token}/withdraw", json={}).status_code == 200
    until(lambda: turtle.handed_in, "it stops and says so")
    summary = the_run(robot_lab).summary
    assert [stop["reason"] for stop in summary["stops"]] == ["told to", "withdrawn"]
    assert "driven_s" in summary
    waiting = robot_lab.somebody()
    until(lambda: the_run(robot_lab).state == "waiting")
    assert robot_lab.skip(the_run(robot_lab).id).status_code == 303
    weights = the_run(robot_lab).weights
    waiting.submit("robot_drive", {"weights": weights})


def test_a_line_that_was_cut_is_made_again_and_a_wrong_token_is_told(robot_lab):
    link = Link(robot_lab.url, "wrong")
    with pytest.raises(LinkError, match="opens nothing"):
        link.about()
    with pytest.raises(LinkError, match="must be http"):
        Link("ftp://somewhere", "x")
    gone = Link("http://127.0.0.1:9", "x")
    gone.open()
    until(lambda: gone.refused is not None)
    assert (gone.refused.status, gone.silent_s, gone.orders.run) == (0, float("inf"), None)
    gone.close()
