"""Every change of a session's state and of a trial's phase stands in one table, and nothing is changed beside it."""

from __future__ import annotations

import ast
from itertools import product
from pathlib import Path
from typing import get_args

import pytest

from desirepath.store.models import Session
from desirepath.study.session.states import (
    FINAL,
    SESSION,
    STATES,
    TRIAL,
    NoSuchChange,
    Who,
    after,
    change,
    draw_diagrams,
)

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("table", [SESSION, TRIAL], ids=["session", "trial"])
def test_every_pair_of_state_and_event_leads_where_the_table_says_or_nowhere(table):
    states = {state for one in table for state in (one.before, one.after)}
    events = {one.event for one in table}
    allowed = {(one.before, one.event, one.who): one.after for one in table}
    assert len(allowed) == len(table)  # no arrow twice
    for before, event, who in product(sorted(states), sorted(events), get_args(Who)):
        if (before, event, who) in allowed:
            assert after(table, before, event, who) == allowed[before, event, who]
        else:
            with pytest.raises(NoSuchChange, match=event):
                after(table, before, event, who)


def test_who_finished_left_or_came_too_late_goes_on_no_more_but_may_withdraw():
    assert set(FINAL) == {"completed", "screened_out", "withdrawn", "expired"}
    for state in STATES:
        session = Session(state=state)
        if state in FINAL:
            with pytest.raises(NoSuchChange):
                change(session, "resume", "participant")
        if state != "withdrawn":
            change(session, "withdraw", "participant")
            assert session.state == "withdrawn"


def test_no_other_file_writes_a_sessions_state_or_a_trials_phase():
    """`X.state = ...` where X is a session, and `phase=` in an update, anywhere but in the table's file."""
    found = []
    for file in (ROOT / "backend").rglob("*.py"):
        if file.name == "states.py":
            continue
        for node in ast.walk(ast.parse(file.read_text())):
            targets = (
                node.targets
                if isinstance(node, ast.Assign)
                else [node.target]
                if isinstance(node, ast.AugAssign)
                else []
            )
            for target in targets:
                if not isinstance(target, ast.Attribute) or target.attr not in ("state", "phase"):
                    continue
                owner = ast.unparse(target.value)
                if target.attr == "phase" or owner in ("session", "one", "following", "acting.session"):
                    found.append(f"{file.relative_to(ROOT)}:{node.lineno}: {owner}.{target.attr}")
    assert found == []


def test_the_picture_in_the_architecture_is_the_table():
    told = (ROOT / "docs" / "architecture.md").read_text()
    for diagram in draw_diagrams().strip().split("\n\n"):
        assert diagram in told, "put what `python -m desirepath.study.session.states` prints into docs/architecture.md"
