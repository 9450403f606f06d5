"""Drives of the immersive view that are watched with a headset: what is stored, and where one is required."""

from __future__ import annotations

import pytest
from pydantic import ValidationError
from sqlalchemy import select

from desirepath.store.models import Trial
from desirepath.study.protocol.freezing import ProtocolError, freeze_text
from desirepath.study.protocol.schema import DeviceGate
from desirepath.study.refusals import Refused
from desirepath.study.session import machine
from desirepath.study.session.devices import device_problems
from desirepath.web.core.addresses import permissions
from desirepath.web.participant.sent import Seen
from tests.study.small_protocol import BLOCK, protocol_text, write_files
from tests.study.walking import answer

QUEST = {
    "controllers": ["meta-quest-touch-plus"],
    "refresh_rate": 90.0,
    "frames": 400,
    "dropped": 2,
    "pointing": ["controller"],
}
INSIDE = {"block": {**BLOCK["block"], "view": "immersive"}}


def watch(walker, *headsets):
    """The first pair, A and B each with that headset or in the window."""
    play = walker.do(machine.start_trial, "block.01", request_id=None, now=walker.now)
    for side, headset in zip("ab", headsets, strict=True):
        walker.later(60)
        play = walker.do(machine.trajectory_seen, "block.01", side, play.playback_id, headset=headset, now=walker.now)
    with walker.database.session() as s:
        return s.scalars(select(Trial).where(Trial.step_key == "block.01")).one()


@pytest.mark.parametrize(("a", "b", "hmd"), [(QUEST, QUEST, True), (QUEST, None, False), (None, None, False)])
def test_a_trial_says_what_it_was_watched_with(walk, a, b, hmd):
    trial = watch(walk(INSIDE, device={"headset": "offered", "webgl": False}), a, b)
    assert (trial.hmd, trial.headset) == (hmd, {"a": a, "b": b})


def test_only_the_view_from_inside_is_seen_with_a_headset(walk):
    trial = watch(walk(BLOCK), QUEST, QUEST)
    assert (trial.hmd, trial.headset) == (False, {"a": None, "b": None})


def test_where_a_headset_is_required_nothing_counts_that_was_watched_without(walk):
    walker = walk(INSIDE, device={"headset": "required", "webgl": False})
    with pytest.raises(Refused) as no:
        watch(walker, None, None)
    assert no.value.code == "headset_required"
    assert walker.view.trial["phase"] == "playing_a"
    walker.do(machine.interrupt, reason="page_loaded", now=walker.now)  # and begins anew
    assert watch(walker, QUEST, QUEST).hmd


def test_where_conditions_differ_in_it_each_is_watched_as_it_says(walk):
    block = {"each": ["headset", "immersive"], "trials": [{"queries": {"count": 1}}]}
    walker = walk({"block": block}, device={"headset": "required", "webgl": False})
    for _ in range(2):
        step = walker.view
        worn = step.trial["worn"]
        assert worn == step.key.startswith("block.headset")
        play = walker.do(machine.start_trial, step.key, request_id=None, now=walker.now)
        walker.later(60)
        seen = (machine.trajectory_seen, step.key, "a", play.playback_id)
        with pytest.raises(Refused) as no:
            walker.do(*seen, headset=None if worn else QUEST, now=walker.now)
        assert no.value.code == ("headset_required" if worn else "window_required")
        play = walker.do(*seen, headset=QUEST if worn else None, now=walker.now)
        walker.later(60)
        seen = (machine.trajectory_seen, step.key, "b", play.playback_id)
        walker.do(*seen, headset=QUEST if worn else None, now=walker.now)
        walker.submit(step.key, {"choice": "a"})
    with walker.database.session() as s:
        assert {trial.block: (trial.view, trial.hmd) for trial in s.scalars(select(Trial))} == {
            "headset": ("immersive", True),
            "immersive": ("immersive", False),
        }


def test_conditions_with_a_headset_need_one(tmp_path):
    write_files(tmp_path)
    block = {"each": ["headset", "immersive"], "trials": [{"queries": {"count": 1}}]}
    with pytest.raises(ProtocolError) as wrong:
        freeze_text(protocol_text([{"block": block}], device={"headset": "offered"}), folder=tmp_path)
    assert "needs device: {headset: required}" in str(wrong.value)


def choose_early(walker, *, hmd, a=QUEST):
    """A choice while B plays; A was watched with that headset."""
    play = walker.do(machine.start_trial, "block.01", request_id=None, now=walker.now)
    walker.later(60)
    walker.do(machine.trajectory_seen, "block.01", "a", play.playback_id, headset=a, now=walker.now)
    walker.later(1)
    walker.submit("block.01", {"choice": "a", "hmd": hmd})
    with walker.database.session() as s:
        return s.scalars(select(Trial).where(Trial.step_key == "block.01")).one()


EARLY = {"block": {**INSIDE["block"], "viewing": {"early_choice": True}}}


@pytest.mark.parametrize(("a", "hmd", "both"), [(QUEST, True, True), (QUEST, False, False), (None, True, False)])
def test_an_early_choice_says_whether_b_was_being_watched_with_one(walk, a, hmd, both):
    trial = choose_early(walk(EARLY, device={"headset": "offered", "webgl": False}), hmd=hmd, a=a)
    assert trial.hmd is both
    assert trial.headset["a"] == a


def test_an_early_choice_without_the_required_one_does_not_count(walk):
    walker = walk(EARLY, device={"headset": "required", "webgl": False})
    with pytest.raises(Refused) as no:
        choose_early(walker, hmd=False)
    assert no.value.code == "headset_required"


SLIDERS = {"tuning": {"scenes": 1, "view": "immersive"}}
CHANGED = {
    "weights": {"clearance": 1.0},
    "history": [{"seconds": 1, "place": 0, "by": "headset", "objective": "clearance", "weight": 1}],
}


def test_sliders_in_the_room_are_not_answered_without_the_required_headset(walk):
    walker = walk(SLIDERS, BLOCK, device={"headset": "required", "webgl": False})
    with pytest.raises(Refused) as no:
        walker.submit("tuning", CHANGED)
    assert no.value.code == "headset_required"
    with pytest.raises(Refused, match="at most 4 items"):
        walker.submit("tuning", CHANGED | {"headset": {"controllers": ["x"] * 5}})
    told = {name: QUEST[name] for name in ("controllers", "refresh_rate", "pointing")}
    walker.submit("tuning", CHANGED | {"headset": told})
    stored = answer(walker, "tuning").value
    assert (stored["hmd"], stored["headset"]) == (True, told)


@pytest.mark.parametrize(("view", "stored"), [("immersive", {"hmd": False, "headset": None}), ("top_down", {})])
def test_sliders_say_whether_a_headset_was_worn_where_one_can_be(walk, view, stored):
    walker = walk({"tuning": {"scenes": 1, "view": view}}, INSIDE, device={"headset": "offered", "webgl": False})
    walker.submit("tuning", CHANGED)
    found = answer(walker, "tuning").value
    assert {name: found[name] for name in ("hmd", "headset") if name in found} == stored


def test_what_is_typed_is_not_asked_in_a_headset(tmp_path):
    write_files(tmp_path)
    words = {"words": {"view": "immersive"}}
    with pytest.raises(ProtocolError) as wrong:
        freeze_text(protocol_text([INSIDE, words], device={"headset": "required"}), folder=tmp_path)
    assert "cannot be answered in a headset" in str(wrong.value)


def test_a_headset_needs_the_view_from_inside(tmp_path):
    write_files(tmp_path)
    with pytest.raises(ProtocolError) as wrong:
        freeze_text(protocol_text([BLOCK], device={"headset": "offered"}), folder=tmp_path)
    assert "no stage has the view immersive" in str(wrong.value)


def test_a_device_without_one_is_refused_where_one_is_required():
    device = {"webgl": True, "headset": False}
    assert device_problems(DeviceGate(headset="required"), device) == ["headset"]
    assert device_problems(DeviceGate(headset="offered"), device) == []
    assert device_problems(DeviceGate(headset="required"), device | {"headset": True}) == []


@pytest.mark.parametrize(
    "change",
    [
        {"controllers": ["x" * 61]},
        {"controllers": ["x"] * 5},
        {"refresh_rate": -1},
        {"frames": -1},
        {"dropped": 10**9},
        {"pointing": ["nose"]},
    ],
)
def test_what_a_browser_tells_of_its_headset_is_bounded(change):
    Seen.model_validate({"side": "a", "headset": QUEST})
    with pytest.raises(ValidationError):
        Seen.model_validate({"side": "a", "headset": QUEST | change})


def test_the_stage_may_use_a_headset_where_the_study_asks_for_one():
    assert permissions().endswith("xr-spatial-tracking=(self)")
    assert permissions(room="https://stage.example:8443").endswith(
        'xr-spatial-tracking=(self "https://stage.example:8443")'
    )
    assert permissions(room='http://a" *').endswith("xr-spatial-tracking=*"), "nothing of an odd address is repeated"
