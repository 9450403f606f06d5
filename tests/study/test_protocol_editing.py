"""What the editor changes of a protocol is what was meant, and nothing else: every other line stays, comments too."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from desirepath.grammar.editing import EditError, insert, move, remove, set_value
from desirepath.grammar.source import Path, Source
from desirepath.study.protocol.freezing import find_shipped_protocols

SHIPPED = {file.stem: file.read_text() for file in find_shipped_protocols()}
BY_HAND = """\
# What it is about.
protocol: mine   # a name
title: {en: "Ways, mine", de: 'Wege: meine'}
languages:
- en
- de

stages:
    # who we are
    - information: {text: a.md}   # first

    # agreed to before anything is asked

    - consent:
        text: consent.md
        version: 1.10    # as printed
        # nothing may be declined
    -   block:
          trials: [{queries: {count: 3}}, {queries: {count: 15, role: regular}}]
          view: >-
            top_down
          viewing:
    - debriefing: {text: d.md, completion_code: random,
                   return_url: "https://example.org/?a=1#b"}  # last
"""
TEXTS = [*SHIPPED.values(), BY_HAND]
WORDS = st.one_of(
    st.text(max_size=30),
    st.sampled_from(
        ["yes", "0o17", "1e3", "1_000", "null", "~", "<<", "a: b", "#x", "- a", "x # y", "{", "‘ü’ 🤖", " "]
    ),
)
VALUES = st.one_of(st.integers(-(10**6), 10**6), st.booleans(), st.floats(-1e6, 1e6).map(lambda n: round(n, 3)), WORDS)

patient = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])  # on a busy machine


def places(data: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Everything below, with where it is."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ():
        yield (*path, key), value
        yield from places(value, (*path, key))


def data_of(text: str) -> Any:
    return Source("protocol.yaml", text).data


def comments(text: str) -> Counter[str]:
    return Counter(line[line.rindex("# ") :].strip() for line in text.splitlines() if "# " in line)


@patient
@given(text=st.sampled_from(TEXTS), value=VALUES, draw=st.data())
def test_a_changed_value_changes_its_line_alone(text: str, value: Any, draw: st.DataObject):
    paths = [path for path, there in places(data_of(text)) if not isinstance(there, dict | list)]
    path = draw.draw(st.sampled_from(paths))
    after = set_value(text, path, value)
    assert json.dumps(dict(places(data_of(after)))[path]) == json.dumps(value)
    differing = [pair for pair in zip(text.splitlines(), after.splitlines(), strict=False) if pair[0] != pair[1]]
    if path[-1] != "view" or ">-" not in text:  # a text over two lines becomes one of one
        assert len(after.splitlines()) == len(text.splitlines())
        assert len(differing) <= 1
    assert comments(after) >= comments(text)


@patient
@given(text=st.sampled_from(TEXTS), value=VALUES, draw=st.data())
def test_a_new_key_and_its_removal_leave_the_text_as_it_was(text: str, value: Any, draw: st.DataObject):
    mappings = [(), *(path for path, there in places(data_of(text)) if isinstance(there, dict))]
    path = (*draw.draw(st.sampled_from(mappings)), "a_new_key")
    after = set_value(text, path, value)
    assert comments(after) >= comments(text)
    assert remove(after, path) == text


@patient
@given(text=st.sampled_from(TEXTS), draw=st.data())
def test_a_stage_that_is_added_and_removed_leaves_the_text_as_it_was(text: str, draw: st.DataObject):
    index = draw.draw(st.integers(0, len(data_of(text)["stages"])))
    stage = {"block": {"view": "top_down", "trials": [{"queries": {"count": 15}}], "each": {"view": ["a", "b"]}}}
    after = insert(text, ("stages",), index, stage)
    assert data_of(after)["stages"][index] == stage
    kept = after.splitlines()
    for line in text.splitlines():
        assert line in kept
    assert remove(after, ("stages", index)) == text


@patient
@given(text=st.sampled_from(TEXTS), draw=st.data())
def test_a_moved_stage_takes_its_comments_along_and_comes_back(text: str, draw: st.DataObject):
    places_of = st.integers(0, len(data_of(text)["stages"]) - 1)
    index, to = draw.draw(places_of), draw.draw(places_of)
    after = move(text, ("stages",), index, to)
    assert Counter(after.splitlines()) == Counter(text.splitlines())
    assert data_of(after)["stages"][to] == data_of(text)["stages"][index]
    if text is not BY_HAND:  # a blank line goes with what is above it
        assert move(after, ("stages",), to, index) == text


@patient
@given(text=st.sampled_from(TEXTS), draw=st.data())
def test_what_is_removed_takes_no_other_line_along(text: str, draw: st.DataObject):
    path, _ = draw.draw(st.sampled_from([*places(data_of(text))]))
    after = remove(text, path)
    before = iter(text.splitlines())
    whole = [line for line in after.splitlines() if line in text.splitlines()]
    assert all(line in before for line in whole), "lines stand in another order"
    assert len(after.splitlines()) - len(whole) <= 1, "at most the line that it stood on is another one"


def test_short_lists_and_places_that_are_not_there_yet():
    text = "protocol: x\nviewing:\nstages: []   # none yet\n"
    first = insert(text, ("stages",), 0, {"consent": {"text": "a"}})
    assert first == "protocol: x\nviewing:\nstages:\n  - consent: {text: a}   # none yet\n"
    assert data_of(set_value(text, ("viewing", "replays"), 1))["viewing"] == {"replays": 1}
    assert data_of(insert("a: {b: [1, 2]}", ("a", "b"), 2, 3)) == {"a": {"b": [1, 2, 3]}}
    assert data_of(insert("a: {b: [1, 2]}", ("a", "b"), 0, 0)) == {"a": {"b": [0, 1, 2]}}
    assert move("a: [1, {x: 2},  3] # c", ("a",), 2, 0) == "a: [3, 1,  {x: 2}] # c"
    assert move("a:\n- - 1\n  - 2\n- 3\n", ("a",), 0, 1) == "a:\n- 3\n- - 1\n  - 2\n"
    assert set_value("a: [1]\nb: 2", ("c", "d", "e"), [1]) == "a: [1]\nb: 2\nc: {d: {e: [1]}}"
    assert remove("a: {b: 1}\n", ("a", "b")) == "a: {}\n"


@pytest.mark.parametrize(
    ("text", "change"),
    [
        ("a: &x {b: 1}\nc: *x\n", lambda text: set_value(text, ("c", "b"), 2)),
        ("a: &x {b: 1}\nc: *x\n", lambda text: set_value(text, ("a", "b"), 2)),
        ("a: &x {b: 1}\nc: *x\n", lambda text: remove(text, ("a",))),
        ("a:\n- - 1\n  - 2\n- 3\n", lambda text: move(text, ("a", 0), 0, 1)),
        ("a: [1]\n", lambda text: set_value(text, ("a", 1), 2)),
        ("a: [1]\n", lambda text: set_value(text, ("a", "b"), 2)),
        ("a: [1]\n", lambda text: remove(text, ("b",))),
        ("a: [1]\n", lambda text: insert(text, ("a",), 2, 2)),
        ("a: [1]\n", lambda text: move(text, ("a",), 0, 1)),
        ("a: {b: 1, # why\n    c: 2}\n", lambda text: remove(text, ("a", "b"))),
    ],
)
def test_what_would_change_something_else_is_refused(text: str, change: Any):
    with pytest.raises(EditError):
        change(text)


def test_a_remark_behind_the_beginning_of_a_text_of_several_lines_stays():
    text = "title:\n  en: |  # said to everybody\n    Hello\n    there\n  # below\n  de: Hallo\n"
    told = set_value(text, ("title", "en"), "Welcome")
    assert told == "title:\n  en: Welcome  # said to everybody\n  # below\n  de: Hallo\n"
