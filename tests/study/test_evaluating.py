"""Both appointments of the demonstration study: paths are drawn, and later three controllers are watched and rated."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from functools import partial
from itertools import permutations
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select

from desirepath.installed import PROTOCOLS
from desirepath.simulation.demonstration_scenes import pair_seed
from desirepath.simulation.scene import Scene
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.database import Database
from desirepath.store.models import Artefact, Job, Response, Session, StrokeRow, Trial
from desirepath.study.drawing import paths, strokes
from desirepath.study.kind import dump_plan
from desirepath.study.kinds.demonstration import drawing_of
from desirepath.study.links import next_token
from desirepath.study.plan.counterbalancing import design_of
from desirepath.study.protocol.freezing import freeze_text, validate_protocol_file
from desirepath.study.protocol.headset_words import HEADSET
from desirepath.study.protocol.planning import make_plan
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.study.session.devices import headset_required
from desirepath.study.session.finding import acting
from desirepath.study.session.joining import join_study
from desirepath.study.studies import create_study
from tests.study.walking import DEMOGRAPHICS, Walker

STUDY = PROTOCOLS / "demonstration_study.yaml"
QUEST = {"controllers": ["meta-quest-touch-plus"], "pointing": ["controller"]}
IN_HEADSET = (  # as docs/protocol-reference.md says
    ("view: top_down", "view: immersive"),
    ("\nstages:", "\ndevice: {headset: required}\n\nstages:"),
)
ITEMS = dict.fromkeys(("comfort", "intuitive", "environments", "speed_control", "effort"), 4)
GATE = "{headset: required, webgl: false}"  # a walker's device shows nothing
DRIVES = ("base", "own", "social_cost")
RATING = {"comfort": 4, "too_close": 2, "preference": 5}


@pytest.fixture
def database(tmp_path: Path) -> Database:
    """An empty one: no query is needed here."""
    empty = Database(f"sqlite:///{tmp_path / 'desirepath.sqlite'}")
    empty.migrate()
    return empty


@pytest.fixture
def walker(database: Database, files: ArtefactStore) -> Walker:
    """Somebody who has finished the first appointment: two places in the corridor, one path in each of them."""
    text = STUDY.read_text()
    room = next(line for line in text.splitlines(keepends=True) if "environment: room" in line)
    text = text.replace(room, "").replace("pairs: 4, per_pair: 3, up_to: 5", "pairs: 2, per_pair: 1")
    return first_appointment(database, files, text)


def first_appointment(
    database: Database, files: ArtefactStore, text: str, headset: dict[str, Any] | None = None
) -> Walker:
    with database.transaction() as s:
        study = create_study(s, files, freeze_text(text), name="Two appointments", created_by=None)
    walker = Walker(database, files, study)
    walker.submit("information", {})
    walker.submit("consent", {"given": True})
    walker.submit("demographics", DEMOGRAPHICS)
    walker.submit("instruction", {})
    while walker.view.kind == "demonstration":
        keep_a_path(walker, headset)
    walker.submit("train.drawing_items", ITEMS)
    assert walker.view.kind == "appointment"
    return walker


def keep_a_path(walker: Walker, headset: dict[str, Any] | None) -> None:
    key = walker.view.key
    along = [k / 80 for k in range(81)]
    with acting(walker.database, walker.token, request="stroke", now=walker.now) as (s, session):
        step = drawing_of(session)
        given = {"points": around(paths.scene_of(step), along), "speeds": [0.25] * 81, "times_s": along}
        if headset is not None:
            given |= {"pointer": "controller", "headset": headset}
        attempt = strokes.attempt_of(step, given, simulated=False)
        worn = {"must_wear": headset_required(s, session)}
        strokes.add_stroke(
            s, walker.files, session, step, attempt, request_id=f"for {key}", client_time=None, now=walker.now, **worn
        )
    state = walker.view.trial
    walker.later(state["duration_s"] + 0.1)
    with acting(walker.database, walker.token, request="driven", now=walker.now) as (s, session):
        seen = (drawing_of(session), state["playback_id"])
        strokes.mark_watched(s, walker.files, session, *seen, now=walker.now, headset=headset, **worn)
    walker.submit(key, {"stroke": state["stroke"]})


def around(scene: Scene, along: list[float]) -> list[list[float]]:
    """From the robot to its goal, away from the person."""
    (x, y), (dx, dy) = (scene.start.x, scene.start.y), (scene.goal.x - scene.start.x, scene.goal.y - scene.start.y)
    left = dx * (scene.person.pose.y - y) - dy * (scene.person.pose.x - x)
    bend = math.copysign(3.0, -left) / math.hypot(dx, dy)
    sides = [bend * u * (1 - u) for u in along]
    return [[x + dx * u - dy * side, y + dy * u + dx * side] for u, side in zip(along, sides, strict=True)]


def trained(walker: Walker, *, passed: bool = True) -> None:
    """The training has ended. It takes minutes and is tested as a job; here its result names the drawn drives."""
    with walker.database.transaction() as s:
        strokes = s.scalars(select(StrokeRow).order_by(StrokeRow.pair)).all()
        for job in s.scalars(select(Job)).all():
            learned = s.get_one(Artefact, job.params["snapshot"])
            shown = [
                {**dict.fromkeys(DRIVES, one.trajectory), "scene_seed": pair_seed(one.environment, one.pair)}
                for one in strokes
                if one.environment == learned.setup
            ]
            job.state = "succeeded"
            job.result = {
                "policy": learned.id,
                "passed": passed,
                "comparisons": [],  # none in which both arrive; all are rated all the same
                "situations": shown if passed else [],
            }


def come_back(walker: Walker) -> None:
    """The second appointment, days later."""
    walker.token = next_token(walker.token)
    walker.later(2 * 24 * 3600)
    with walker.database.session() as s:
        walker.session = s.scalars(select(Session).where(Session.appointment == 2)).one()


def refusal(action: Callable[[], Any]) -> str:
    with pytest.raises(Refused) as told:
        action()
    return told.value.code


def test_three_controllers_are_watched_blind_and_rated(walker: Walker):
    trained(walker)
    come_back(walker)
    walker.submit("instruction_2", {})
    rated = []
    for robot in (1, 2, 3):
        for number in (1, 2):
            view = walker.view
            assert (view.kind, view.key) == ("evaluation", f"evaluation.corridor.{robot}.{number}")
            assert view.payload == {"role": "regular", "view": "top_down", "robot": robot, "number": number, "of": 2}
            assert refusal(lambda: walker.submit(walker.view.key, {})) == "too_early"
            shown = walker.do(machine.start_trial, view.key, request_id=None, now=walker.now)
            assert shown.label == ""
            told = ("a", shown.playback_id)
            assert refusal(partial(walker.do, machine.trajectory_seen, view.key, *told, now=walker.now)) == "too_early"
            walker.later(view.trial["duration_a_s"] + 0.1)
            walker.do(machine.trajectory_seen, view.key, "a", shown.playback_id, now=walker.now)
            assert walker.view.trial["phase"] == "choosing"
            walker.submit(view.key, {})
        assert walker.view.key == f"evaluation.corridor.{robot}.drawing_rating"
        walker.submit(walker.view.key, RATING)
        rated.append(robot)
    assert walker.view.kind == "debriefing"
    assert personalisation_of(walker) == "shown"
    with walker.database.session() as s:
        trials = s.scalars(select(Trial).order_by(Trial.index)).all()
        assert {trial.block for trial in trials} == {"social_cost", "dwa", "own"}
        assert [trial.block for trial in trials[::2]] == [trial.block for trial in trials[1::2]]
        own = next(trial for trial in trials if trial.block == "own")
        assert own.arms["a"] == s.scalars(select(Artefact.id).where(Artefact.kind == "demonstrations")).one()
        plan = walker.session.plan
        asked = {step["key"]: step["block"] for step in plan if step.get("questionnaire") == "drawing_rating"}
        given = s.scalars(select(Response).where(Response.step_key.in_(asked))).all()
        assert {asked[response.step_key] for response in given} == {"social_cost", "dwa", "own"}


def test_both_appointments_are_walked_in_a_required_headset_to_the_code(database: Database, files: ArtefactStore):
    text = STUDY.read_text()
    for old, new in (*IN_HEADSET, ("pairs: 4, per_pair: 3, up_to: 5", "pairs: 1, per_pair: 1")):
        text = text.replace(old, new)
    walker = first_appointment(database, files, text.replace("{headset: required}", GATE), QUEST)
    trained(walker)
    come_back(walker)
    walker.submit("instruction_2", {})
    while (view := walker.view).kind != "debriefing":
        if view.kind == "questionnaire":
            walker.submit(view.key, RATING)
            continue
        assert (view.kind, view.payload["view"]) == ("evaluation", "immersive")
        shown = walker.do(machine.start_trial, view.key, request_id=None, now=walker.now)
        walker.later(view.trial["duration_a_s"] + 0.1)
        seen = partial(walker.do, machine.trajectory_seen, view.key, "a", shown.playback_id, now=walker.now)
        assert refusal(seen) == "headset_required"
        seen(headset=QUEST)
        walker.submit(view.key, {})
    with database.session() as s:
        assert s.get_one(Session, walker.session.id).completion_code
        assert [(row.hmd, row.environment) for row in s.scalars(select(StrokeRow).order_by(StrokeRow.created_at))] == [
            (True, "corridor"),
            (True, "room"),
        ]
        assert [(trial.hmd, trial.headset) for trial in s.scalars(select(Trial))] == [(True, {"a": QUEST})] * 6


def test_the_study_as_shipped_becomes_one_in_a_headset_by_two_changes_and_a_sentence(tmp_path: Path):
    shutil.copytree(PROTOCOLS, tmp_path / "own")
    file = tmp_path / "own" / STUDY.name
    text = file.read_text()
    for old, new in IN_HEADSET:
        text = text.replace(old, new)
    file.write_text(text)
    found = validate_protocol_file(file)
    assert found["valid"], found["errors"]
    assert [one["field"] for one in found["warnings"]] == ["device.headset"] * 2, "a text in each language lacks it"
    for language, sentence in HEADSET.items():
        with (file.parent / f"texts/drawing_study_information.{language}.md").open("a") as information:
            information.write(f"\n{sentence}\n")
    assert validate_protocol_file(file) == {"valid": True, "errors": []}


def test_the_six_orders_are_filled_evenly_and_reversed_in_the_second_environment(
    database: Database, files: ArtefactStore
):
    protocol = freeze_text(STUDY.read_text()).protocol
    orders = []
    for place in design_of(protocol).rows:
        for seed in (0, 1):
            plan = dump_plan(make_plan(protocol, seed, [], place))
            asked = [step for step in plan if step.get("questionnaire") == "drawing_rating"]
            met = [step["block"] for step in asked]
            assert len({step["environment"] for step in asked[:3]}) == 1
            assert met[3:] == met[2::-1]
            assert all(sum(i % 3 for i, block in enumerate(met) if block == name) == 2 for name in met)
        orders.append(tuple(met[:3]))
    assert sorted(orders) == sorted(permutations(("social_cost", "dwa", "own")))
    with database.transaction() as s:
        study = create_study(s, files, freeze_text(STUDY.read_text()), name="Six", created_by=None)
        joined = [join_study(s, study, language="en", files=files)[0] for _ in range(6)]
        given = [session.assignment["order"] for session in joined]
    assert sorted(map(tuple, given)) == sorted(orders)


def test_nobody_is_shown_robots_that_could_not_be_learned(walker: Walker):
    trained(walker, passed=False)
    come_back(walker)
    walker.submit("instruction_2", {})
    assert walker.view.kind == "debriefing"
    assert personalisation_of(walker) == "gate_not_passed"


def settled(walker: Walker) -> bool:
    with acting(walker.database, walker.token, request="settle", now=walker.now) as (s, session):
        return machine.settle(s, walker.files, session, now=walker.now)


def personalisation_of(walker: Walker) -> str | None:
    with walker.database.session() as s:
        return s.scalars(select(Session.personalisation).where(Session.appointment == 2)).one()


def test_who_comes_back_before_the_robots_are_learned_waits_for_them(walker: Walker):
    come_back(walker)
    walker.submit("instruction_2", {})
    assert (walker.view.kind, walker.view.payload) == ("wait", {"learns_from": "paths"})
    assert not settled(walker)
    trained(walker)
    assert settled(walker)
    assert walker.view.key == "evaluation.corridor.1.1"
    assert personalisation_of(walker) == "shown"


def test_nobody_waits_for_ever(walker: Walker):
    come_back(walker)
    walker.submit("instruction_2", {})
    walker.later(901)
    settled(walker)
    assert walker.view.kind == "debriefing"
    assert personalisation_of(walker) == "late"
