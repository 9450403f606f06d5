"""Drawing paths: every stroke is stored, what can be driven is driven and kept, nothing is lost and nothing jumps."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sqlalchemy import func, select

from desirepath.demonstrations.demonstration import Demonstration
from desirepath.simulation.trajectory import Outcome
from desirepath.store.artefacts import ArtefactStore, load_trajectory
from desirepath.store.audit import record
from desirepath.store.database import Database
from desirepath.store.dataset.importing import import_dataset
from desirepath.store.dataset.writing import export_study
from desirepath.store.demonstration_snapshots import (
    StrokeError,
    demonstrations_of,
    read_demonstrations,
    take_demonstrations,
)
from desirepath.store.erasure import erase_participant
from desirepath.store.models import Artefact, Audit, Job, Participant, Response, Session, StrokeRow, Study
from desirepath.study.drawing import paths, strokes, walks
from desirepath.study.kinds.demonstration import drawing_of
from desirepath.study.protocol.freezing import freeze_text
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.study.session.finding import acting
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.studies import create_study
from tests.study.walking import Walker

QUICK = Path(__file__).resolve().parents[2] / "study_protocols" / "quick_demonstration_study.yaml"
ONE_PLACE = ("pairs: 2, per_pair: 2", "pairs: 1, per_pair: 1, up_to: 3")


@pytest.fixture
def database(tmp_path: Path) -> Database:
    """An empty one: no query is needed here."""
    empty = Database(f"sqlite:///{tmp_path / 'desirepath.sqlite'}")
    empty.migrate()
    return empty


@pytest.fixture
def study(database: Database, files: ArtefactStore) -> Study:
    """The quick protocol with one place, one path to draw and two more for who likes."""
    with database.transaction() as s:
        text = QUICK.read_text().replace(*ONE_PLACE)
        return create_study(s, files, freeze_text(text), name="Drawing", created_by=None)


@pytest.fixture
def walker(database: Database, files: ArtefactStore, study: Study) -> Walker:
    """A person who stands before the first path."""
    walker = Walker(database, files, study)
    for key, value in {"information": {}, "consent": {"given": True}, "instruction": {}}.items():
        walker.submit(key, value)
    return walker


def path(bend_m: float, **more: Any) -> dict[str, Any]:
    """What a page sends: an arc through the corridor, `bend_m` to the left at its middle."""
    u = np.linspace(0.0, 1.0, 80)
    points = np.stack([-3.2 + 6.4 * u, bend_m * np.sin(np.pi * u)], axis=1)
    return {
        "points": points.tolist(),
        "speeds": np.full(80, 0.2).tolist(),
        "times_s": (4 * u).tolist(),
        "pointer": "mouse",
        **more,
    }


def act(walker: Walker, action: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """One request at the current step: `action(s, session, step, ...)`."""
    with acting(walker.database, walker.token, request=action.__name__, now=walker.now) as (s, session):
        return action(s, session, drawing_of(session), *arguments, **named)


def draw(walker: Walker, given: dict[str, Any], request_id: str | None = None, *, must_wear: bool = False) -> StrokeRow:
    """Send a stroke at the current step, as the route does."""
    walker.requests += 1
    with acting(walker.database, walker.token, request="stroke", now=walker.now) as (s, session):
        step = drawing_of(session)
        attempt = strokes.attempt_of(step, given, simulated=session.simulated)
        name = request_id or f"{session.id}-stroke-{walker.requests}"
        row = strokes.add_stroke(
            s,
            walker.files,
            session,
            step,
            attempt,
            request_id=name,
            client_time=None,
            now=walker.now,
            must_wear=must_wear,
        )
        s.flush()
        s.expunge(row)
        return row


def driven(walker: Walker, playback: str | None, walk: dict[str, Any] | None = None, **worn: Any) -> StrokeRow:
    """What the page tells when a drive has been watched, and what was walked beside it."""
    with acting(walker.database, walker.token, request="driven", now=walker.now) as (s, session):
        step = drawing_of(session)
        walked = None
        if walk is not None:
            stroke = paths.latest_stroke(s, session.id, step.key)
            scene = paths.scene_of(step)
            walked = walks.combine_with_walk(scene, stroke.drawn, stroke.trajectory, walk, simulated=False)
        return strokes.mark_watched(s, walker.files, session, step, playback, walked, now=walker.now, **worn)


def stored_strokes(walker: Walker) -> list[StrokeRow]:
    with walker.database.session() as s:
        return list(s.scalars(select(StrokeRow).order_by(StrokeRow.created_at, StrokeRow.attempt)))


def refusal(action: Callable[[], Any]) -> str:
    with pytest.raises(Refused) as told:
        action()
    return told.value.code


QUEST = {"controllers": ["meta-quest-touch-plus"], "frames": 900, "pointing": ["controller"]}
INSIDE = (("pairs: 2, per_pair: 2, view: top_down", "pairs: 1, per_pair: 1, view: immersive"),)


@pytest.fixture
def inside(database: Database, files: ArtefactStore) -> Walker:
    """A person before the first path, which is drawn from inside, where a headset may be worn."""
    text = QUICK.read_text()
    for old, new in (*INSIDE, ("stages:", "device: {headset: required, webgl: false}\nstages:")):
        text = text.replace(old, new)
    with database.transaction() as s:
        study = create_study(s, files, freeze_text(text), name="In", created_by=None)
    walker = Walker(database, files, study)
    for key, value in {"information": {}, "consent": {"given": True}, "instruction": {}}.items():
        walker.submit(key, value)
    return walker


def test_a_path_drawn_with_a_headset_is_the_same_path_with_the_headset_beside_it(inside: Walker):
    assert refusal(lambda: draw(inside, path(0.7), must_wear=True)) == "headset_required"
    mixed = path(0.7, pointer="controller+mouse", headset=QUEST)
    assert refusal(lambda: draw(inside, mixed, must_wear=True)) == "headset_required"
    draw(inside, path(0.7, pointer="controller", headset=QUEST), must_wear=True)
    state = inside.view.trial
    inside.later(state["duration_s"] + 0.1)
    assert refusal(lambda: driven(inside, state["playback_id"], must_wear=True)) == "headset_required"
    assert inside.view.trial["phase"] == "driving", "it can be begun again"
    driven(inside, state["playback_id"], headset=QUEST, must_wear=True)
    (row,) = stored_strokes(inside)
    assert (row.hmd, row.headset) == (True, {"drawn": QUEST, "watched": QUEST})
    assert row.drawn == strokes.attempt_of(step_now(inside), path(0.7), simulated=False).drawn


def test_what_was_drawn_with_a_headset_and_watched_without_says_so(inside: Walker):
    draw(inside, path(0.7, pointer="hand", headset=QUEST))
    state = inside.view.trial
    inside.later(state["duration_s"] + 0.1)
    driven(inside, state["playback_id"])
    assert [(row.hmd, row.headset["watched"]) for row in stored_strokes(inside)] == [(False, None)]


def step_now(walker: Walker) -> Any:
    with acting(walker.database, walker.token, request="look", now=walker.now) as (_, session):
        return drawing_of(session)


def test_a_path_is_driven_watched_kept_and_learned_from(walker: Walker, files: ArtefactStore):
    key = walker.view.key
    assert (walker.view.kind, walker.view.trial["phase"]) == ("demonstration", "drawing")
    assert walker.view.payload["optional"] is False
    drawn = draw(walker, path(0.7))
    state = walker.view.trial
    assert (state["phase"], state["stroke"]) == ("driving", drawn.id)
    drive = load_trajectory(files, drawn.trajectory)
    assert drive.outcome == Outcome.SUCCESS
    assert state["duration_s"] == pytest.approx(drive.duration_s)
    assert Demonstration.from_bytes(files.get(drawn.demonstration)).trajectory.digest() == drawn.trajectory
    # The server's clock: nobody has seen it yet, and another showing is not this one.
    keep = {"stroke": drawn.id}
    assert refusal(lambda: walker.submit(key, keep)) == "too_early"
    assert refusal(lambda: driven(walker, state["playback_id"])) == "too_early"
    walker.later(state["duration_s"] + 0.1)
    assert refusal(lambda: driven(walker, "another")) == "other_playback"
    driven(walker, state["playback_id"])
    assert walker.view.trial["phase"] == "watched"
    walker.submit(key, keep)
    assert [row.state for row in stored_strokes(walker)] == ["kept"]
    # The next path of this place is wanted only by who likes; with it the others fall away, and training begins.
    assert walker.view.payload["optional"] is True
    assert refusal(lambda: walker.submit(walker.view.key, {})) == "bad_value"
    walker.submit(walker.view.key, {"skipped": True})
    assert walker.view.key == "train.drawing_items"
    with walker.database.session() as s:
        (job,) = s.scalars(select(Job)).all()
        snapshot = s.get_one(Artefact, job.params["snapshot"])
        assert (job.kind, snapshot.kind, snapshot.setup) == ("train_demonstrations", "demonstrations", "corridor")
        environment, (kept,) = read_demonstrations(files.get(snapshot.id))
        assert (environment, kept.stroke, kept.demonstration) == ("corridor", drawn.id, drawn.demonstration)
        assert s.get_one(Response, kept.response).value == keep
    with walker.database.transaction() as s:
        person = s.get_one(Participant, walker.session.participant_id)
        person.consents = {"training": False}
        s.flush()
        with pytest.raises(StrokeError, match="may be learned from"):
            take_demonstrations(s, files, study_id=person.study_id, environment="corridor")
        person.consents = {"training": True}
        assert len(demonstrations_of(s, study_id=person.study_id)) == 1
    walker.do(machine.withdraw, now=walker.now)
    with walker.database.session() as s:
        assert s.get_one(Artefact, snapshot.id).quarantined_at is not None


def test_what_cannot_be_driven_is_told_and_stored_all_the_same(walker: Walker):
    y = paths.scene_of(_step(walker)).person.pose.y
    told = draw(walker, path(y))
    assert (told.state, told.trajectory, told.problem["code"], told.problem["thing"]) == (
        *("refused", None, "collides", "person"),
    )
    assert told.problem["at"][1] == pytest.approx(y, abs=0.3)
    short = {name: value[:4] if isinstance(value, list) else value for name, value in path(0.7).items()}
    assert draw(walker, short).problem["code"] == "too_short"
    away = path(0.7) | {"points": [[x + 1.5, y] for x, y in path(0.7)["points"]]}
    assert draw(walker, away).problem["code"] in ("starts_away", "leaves_room")
    assert walker.view.trial["phase"] == "drawing"
    assert [row.attempt for row in stored_strokes(walker)] == [1, 2, 3]
    assert stored_strokes(walker)[0].drawn["points"] == path(y)["points"]
    assert refusal(lambda: draw(walker, {"points": [["x", 1]], "speeds": [1], "times_s": [0]})) == "bad_value"
    assert refusal(lambda: draw(walker, path(0.7, pointer="bot"))) == "bad_value"


def test_drawn_again_interrupted_and_sent_twice(walker: Walker):
    first = draw(walker, path(0.7), request_id="the-same-request")
    assert draw(walker, path(0.7), request_id="the-same-request").id == first.id
    assert refusal(lambda: draw(walker, path(0.75))) == "drawn_already"
    assert walker.do(machine.interrupt, reason="page_loaded", now=walker.now) is True
    assert walker.do(machine.interrupt, reason="page_loaded", now=walker.now) is False
    assert walker.view.trial["phase"] == "ready"
    act(walker, strokes.roll_out, now=walker.now)
    assert walker.view.trial["playback_id"]
    act(walker, strokes.redraw)
    assert walker.view.trial["phase"] == "drawing"
    assert refusal(lambda: walker.submit(walker.view.key, {"stroke": first.id})) == "nothing_drawn"
    assert draw(walker, path(0.75)).attempt == 2
    assert [row.state for row in stored_strokes(walker)] == ["redone", "drawn"]
    # A later drive than the one that is being shown was never watched.
    shown = walker.view.trial
    walker.do(machine.pause, now=walker.now)
    walker.do(machine.resume, now=walker.now)
    walker.later(1.0)
    act(walker, strokes.roll_out, now=walker.now)
    walker.later(shown["duration_s"] + 1)
    told = refusal(lambda: driven(walker, shown["playback_id"]))
    assert told == "other_playback"


def who_walks(database: Database, files: ArtefactStore, person: str) -> Walker:
    """A person before a path that is driven with a person who is not still."""
    text = QUICK.read_text().replace("pairs: 2, per_pair: 2", f"pairs: 1, per_pair: 1, person: {person}")
    with database.transaction() as s:
        study = create_study(s, files, freeze_text(text), name="Walking", created_by=None)
    walker = Walker(database, files, study)
    for key, value in {"information": {}, "consent": {"given": True}, "instruction": {}}.items():
        walker.submit(key, value)
    return walker


def recording(walker: Walker, to: tuple[float, float], duration_s: float, hz: int = 30) -> dict[str, Any]:
    """Who walks at 1 m/s from where the person stands to a place, and stays."""
    begin = paths.scene_of(_step(walker)).person.pose
    times = np.arange(0.0, duration_s, 1 / hz)
    way = np.subtract(to, (begin.x, begin.y))
    share = np.clip(times / np.linalg.norm(way), 0.0, 1.0)[:, None]
    places = np.array([begin.x, begin.y]) + share * way
    return {"times_s": times.tolist(), "poses": np.column_stack([places, np.full(len(times), 0.5)]).tolist()}


def test_who_walks_beside_the_drive_is_kept_whole_with_it_and_learned_from(database: Database, files: ArtefactStore):
    walker = who_walks(database, files, "walks")
    drawn = draw(walker, path(0.7))
    state = walker.view.trial
    assert (state["phase"], state["walking"], drawn.demonstration, drawn.walk) == ("driving", True, None, None)
    side = -1.0 if paths.scene_of(_step(walker)).person.pose.y < 0 else -1.1
    place = (paths.scene_of(_step(walker)).person.pose.x + 0.6, side)
    walk = recording(walker, place, state["duration_s"] + 0.1)
    walker.later(state["duration_s"] + 3.0)
    # What nobody can have walked, walked sparsely, walked too short, or elsewhere is not taken.
    for wrong in (
        {"times_s": [0.0, 1.0], "poses": [[0.0, 0.0, 0.0]]},
        recording(walker, place, state["duration_s"], hz=10),
        walk | {"poses": [[x + 1.0, y, yaw] for x, y, yaw in walk["poses"]]},
        walk | {"poses": [walk["poses"][0]] + [[x + 3.0, y, yaw] for x, y, yaw in walk["poses"][1:]]},
    ):
        assert refusal(lambda wrong=wrong: driven(walker, state["playback_id"], wrong)) == "bad_value"
    assert refusal(lambda: driven(walker, state["playback_id"])) == "not_walked"
    assert refusal(lambda: driven(walker, state["playback_id"], recording(walker, place, 5.0))) == "not_walked"
    driven(walker, state["playback_id"], walk)
    (row,) = stored_strokes(walker)
    assert (row.state, row.walk["source"], row.walk["beside"]) == ("watched", "walked", drawn.trajectory)
    assert (row.walk["times_s"], row.walk["poses"]) == (walk["times_s"], walk["poses"])
    made = Demonstration.from_bytes(files.get(row.demonstration))
    where = made.scene.walk.poses_at(walk["times_s"])
    assert np.abs(where[:, :2] - np.array(walk["poses"])[:, :2]).max() < 0.05
    assert load_trajectory(files, row.trajectory).scene.walk == made.drawn_in.walk == made.scene.walk
    # Watched from outside, then walked once more: the walk before stays stored.
    act(walker, strokes.roll_out, now=walker.now)
    assert (walker.view.trial["phase"], walker.view.trial["walking"]) == ("driving", False)
    with database.session() as s:
        assert paths.showing(_step(walker), paths.latest_stroke(s, row.session_id, row.step_key)).view == "top_down"
    walker.later(state["duration_s"] + 0.1)
    driven(walker, walker.view.trial["playback_id"])
    act(walker, strokes.walk_again, request_id="again", now=walker.now)
    assert (walker.view.trial["phase"], walker.view.trial["walking"]) == ("driving", True)
    # Into the robot's way: told kindly, with the place and the second, and both stay stored.
    robot = load_trajectory(files, drawn.trajectory)
    at = robot.poses[len(robot.poses) // 2]
    walker.later(state["duration_s"] + 3.0)
    driven(walker, walker.view.trial["playback_id"], recording(walker, (at[0], at[1]), state["duration_s"]))
    told = stored_strokes(walker)[-1]
    assert (told.state, told.problem["code"], told.problem["thing"]) == ("refused", "collides", "person")
    assert 0 < told.problem["after_s"] < state["duration_s"]
    assert np.hypot(told.problem["at"][0] - at[0], told.problem["at"][1] - at[1]) < 1.0
    assert (walker.view.trial["phase"], walker.view.trial["met"]) == ("drawing", True)
    assert told.walk["beside"] == drawn.trajectory
    act(walker, strokes.walk_again, request_id="and-again", now=walker.now)
    assert refusal(lambda: walker.submit(walker.view.key, {"stroke": stored_strokes(walker)[-1].id})) == "too_early"
    walker.later(state["duration_s"] + 3.0)
    driven(walker, walker.view.trial["playback_id"], walk)
    last = stored_strokes(walker)[-1]
    assert [one.state for one in stored_strokes(walker)] == ["redone", "refused", "watched"]
    walker.submit(walker.view.key, {"stroke": last.id})
    with database.session() as s:
        (job,) = s.scalars(select(Job)).all()
        _, (kept,) = read_demonstrations(files.get(job.params["snapshot"]))
        assert Demonstration.from_bytes(files.get(kept.demonstration)).scene.walk is not None


def test_a_walk_is_chosen_before_the_path_is_drawn(database: Database, files: ArtefactStore):
    walker = who_walks(database, files, "recorded")
    offered = walks.offer_walks(_step(walker))
    assert [walk["source"] for walk in offered] == ["planned"] * 3
    assert refusal(lambda: draw(walker, path(0.7))) == "bad_value"
    assert refusal(lambda: draw(walker, path(0.7, walk=3))) == "bad_value"
    outcomes = {}
    for bend, choice in ((0.7, 0), (-0.7, 0), (0.7, 1), (-0.7, 1), (0.7, 2), (-0.7, 2)):
        row = draw(walker, path(bend, walk=choice))
        assert row.walk == offered[choice]
        outcomes[bend, choice] = row.state
        if row.state == "drawn":
            demonstration = Demonstration.from_bytes(files.get(row.demonstration))
            assert demonstration.scene.walk == walks.scene_with(paths.scene_of(_step(walker)), row.walk).walk
            act(walker, strokes.redraw)
        else:
            assert (row.problem["thing"], row.problem["after_s"] > 0) == ("person", True)
    assert "drawn" in outcomes.values()


@pytest.mark.parametrize("person", ["still", "walks", "recorded"])
def test_bots_draw_are_exported_come_back_and_can_be_erased(
    database: Database, files: ArtefactStore, study: Study, tmp_path: Path, person: str
):
    if person != "still":
        with database.transaction() as s:
            text = QUICK.read_text().replace("pairs: 2, per_pair: 2", f"pairs: 1, per_pair: 1, person: {person}")
            study = create_study(s, files, freeze_text(text), name="Walking", created_by=None)
    done = walk_in_process(database, files, study, 2, without_jobs=True)
    assert (done["completed"], done["participants"]) == (2, 2)
    told = export_study(database, files, study.id, tmp_path / "out")
    rows = list(csv.DictReader((tmp_path / "out" / "strokes.csv").open()))
    kept = [row for row in rows if row["state"] == "kept"]
    assert len(kept) == 2 * (1 if person != "still" else 3)
    assert {row["pointer"] for row in rows} == {"bot"}
    assert {row["simulated"] for row in rows} == {"true"}
    paths = {file["path"] for file in told["files"]}
    assert {f"demonstrations/{row['demonstration']}.npz" for row in kept} <= paths
    assert {f"trajectories/{row['trajectory']}.npz" for row in kept} <= paths
    walked = {row["stroke"]: json.loads(row["walk"]) for row in rows if row["walk"]}
    assert {walk["source"] for walk in walked.values()} == {
        "still": set(),
        "walks": {"walked"},
        "recorded": {"planned"},
    }[person]
    beside = {walk["beside"] for walk in walked.values() if "beside" in walk}
    assert all(walk.get("simulated", walk["source"] == "planned") for walk in walked.values())
    assert {f"trajectories/{name}.npz" for name in beside} <= paths
    steps = next(file["rows"] for file in told["files"] if file["path"] == "trajectory_steps.parquet")
    driven = beside | {row["trajectory"] for row in rows if row["trajectory"]}
    assert steps == sum(len(load_trajectory(files, name).actions) for name in driven)

    other = Database(f"sqlite:///{tmp_path / 'other.sqlite'}")
    other.migrate()
    elsewhere = ArtefactStore((tmp_path / "elsewhere").as_uri())
    import_dataset(other, elsewhere, tmp_path / "out")
    with other.session() as s:
        again = {row.id: row for row in s.scalars(select(StrokeRow))}
    for row in rows:
        assert again[row["stroke"]].drawn == json.loads(row["drawn"])
        assert again[row["stroke"]].walk == walked.get(row["stroke"])
    Demonstration.from_bytes(elsewhere.get(kept[0]["demonstration"]))

    mine = [row for row in kept if row["participant"] == kept[0]["participant"]]
    with database.transaction() as s:
        person = s.get_one(Session, mine[0]["session"]).participant_id
        record(s, "path_left_out", by="tester", study_id=study.id, stroke_id=mine[0]["stroke"])
        record(s, "path_left_out", by="tester", study_id=study.id, stroke_id="another")
        learned = next(a.id for a in s.scalars(select(Artefact)) if a.card.get("session") == mine[0]["session"])
        record(s, "artefact_taken", by="tester", artefact_id=learned)
    assert erase_participant(database, files, person, "tester", data=tmp_path)["counts"]["strokes"] >= len(mine)
    with database.session() as s:
        assert [entry.data["stroke_id"] for entry in s.scalars(select(Audit))] == ["another"]
        left = s.scalar(select(func.count(StrokeRow.id)))
    assert left == sum(row["participant"] != mine[0]["participant"] for row in rows)
    assert not any(files.exists(row["demonstration"]) or files.exists(row["trajectory"]) for row in mine)
    assert not any(files.exists(walked[row["stroke"]]["beside"]) for row in mine if person == "walks")
    others = [row for row in kept if row not in mine]
    assert all(files.exists(row["demonstration"]) and files.exists(row["trajectory"]) for row in others)


def _step(walker: Walker) -> dict[str, Any]:
    with walker.database.session() as s:
        return drawing_of(s.get_one(Session, walker.session.id))
