"""Orders of conditions: what each scheme promises, and places that are filled evenly however people come and go."""

from __future__ import annotations

import threading
from collections import Counter
from datetime import timedelta
from itertools import pairwise, permutations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sqlalchemy import select

from desirepath.store.models import Participant, Session, utc_now
from desirepath.study.kind import dump_plan
from desirepath.study.plan.assignment import assignment_table
from desirepath.study.plan.counterbalancing import design_of, next_row, orders
from desirepath.study.protocol.freezing import ProtocolError, thaw
from desirepath.study.protocol.planning import make_plan, session_seed
from desirepath.study.session.joining import join_study
from desirepath.study.studies import create_study
from tests.study.small_protocol import BLOCK, CROSSED, VIEWS, small_protocol
from tests.study.test_planning import QUERIES, trials

# ---- the schemes -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [2, 3, 4, 5, 6])
def test_williams_designs_let_every_condition_follow_every_other_equally_often(n):
    rows = orders(n, "williams")
    assert len(rows) == (n if n % 2 == 0 else 2 * n)
    follows = Counter(pair for row in rows for pair in pairwise(row))
    assert set(follows) == set(permutations(range(n), 2))
    assert len(set(follows.values())) == 1


@pytest.mark.parametrize("scheme", ["williams", "latin_square", "all_orders"])
@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_every_condition_stands_in_every_place_equally_often(n, scheme):
    rows = orders(n, scheme)
    assert len(set(rows)) == len(rows)
    for place in range(n):
        assert len(set(Counter(row[place] for row in rows).values())) == 1


@settings(max_examples=50, deadline=None)
@given(st.integers(2, 12), st.integers(0, 1000), st.integers(0, 100), st.randoms(use_true_random=False))
def test_places_stay_even_whoever_comes_and_fill_again_whoever_leaves(rows, seed, people, random):
    held = [0] * rows
    for _ in range(people):
        held[next_row(held, seed)] += 1
        assert max(held) - min(held) <= 1
    for row in random.sample(range(rows), k=random.randrange(rows)):
        held[row] = max(0, held[row] - random.randrange(4))
    missing = sum(max(held) - count for count in held)
    for _ in range(missing):
        held[next_row(held, seed)] += 1
    assert len(set(held)) == 1


# ---- plans -----------------------------------------------------------------------------------------------------------


def planned(*asked):
    """A plan as it is stored."""
    return dump_plan(make_plan(*asked))


def test_all_conditions_ask_the_same_queries_with_the_same_sides_in_their_own_order(tmp_path):
    protocol = small_protocol(tmp_path, [CROSSED]).protocol
    plan = planned(protocol, 5, QUERIES)
    shown = {view: [(t["query"], t["sides_swapped"]) for t in trials(plan) if t["view"] == view] for view in VIEWS}
    assert len({frozenset(asked) for asked in shown.values()}) == 1
    many = [planned(protocol, seed, QUERIES) for seed in range(6)]
    assert any([t["query"] for t in trials(plan)[:3]] != [t["query"] for t in trials(plan)[3:6]] for plan in many)
    assert {t["block"] for t in trials(plan)} == set(VIEWS)


def test_a_block_may_ask_other_queries_in_every_condition(tmp_path):
    block = {"block": {**CROSSED["block"], "same_queries": False}}
    plan = planned(small_protocol(tmp_path, [block]).protocol, 5, QUERIES)
    assert len({t["query"] for t in trials(plan)}) == 9


def test_factors_are_crossed_and_one_of_separates_people(tmp_path):
    block = {
        "block": {
            "each": {"view": ["top_down", "immersive"], "told": ["robot", "machine"]},
            "one_of": {"mood": ["calm", "hurried"]},
            "trials": [{"queries": {"count": 2}}],
            "before": [{"instruction": {"text": "{told}_{mood}.md"}}],
        }
    }
    for told in ("robot", "machine"):
        for mood in ("calm", "hurried"):
            (tmp_path / f"{told}_{mood}.md").write_text("# Words\nwords")
    protocol = small_protocol(tmp_path, [block], assignment={"scheme": "latin_square"}).protocol
    design = design_of(protocol)
    assert len(design.rows) == 4 * 2
    plan = planned(protocol, 1, QUERIES, design.rows[-1])
    assert [t["block"] for t in trials(plan)][::2] == [
        "immersive-machine",
        "top_down-robot",
        "top_down-machine",
        "immersive-robot",
    ]
    texts = {step["text"] for step in plan if step["kind"] == "instruction"}
    assert texts == {"robot_hurried.md", "machine_hurried.md"}
    assert design.describe(design.rows[-1], 7)["groups"] == {"block": "hurried"}


def test_transitivity_asks_all_three_pairs_of_three_drives_beside_the_regular_queries(tmp_path):
    block = {"block": {"each": VIEWS, "trials": [{"queries": {"count": 4, "probes": {"transitivity": 2}}}]}}
    protocol = small_protocol(tmp_path, [block]).protocol
    few = [
        type(QUERIES[0])(
            f"t{scene}{pair}", scene_hash=f"t{scene}", trajectory_a=f"{scene}{a}", trajectory_b=f"{scene}{b}"
        )
        for scene in range(3)
        for pair, (a, b) in enumerate([("x", "y"), ("y", "z")])
    ]
    plan = planned(protocol, 3, [*QUERIES, *few])
    for view in VIEWS:
        here = [t for t in trials(plan) if t["view"] == view]
        probes = [t for t in here if t["role"] == "transitivity"]
        assert Counter(t["role"] for t in here) == {"regular": 4, "transitivity": 6}
        asked = Counter(drive for t in probes for drive in (t["trajectory_a"], t["trajectory_b"]))
        assert len(asked) == 6
        assert set(asked.values()) == {2}  # each of three drives meets both others
        scenes = {drive[0] for drive in asked}
        assert not any(
            t["trajectory_a"][0] in scenes and t["trajectory_a"][0].isdigit() for t in here if t not in probes
        )


# ---- places in a study -----------------------------------------------------------------------------------------------


@pytest.fixture
def crossed(tmp_path, database, files, twenty_queries):
    """Opens a study with three views in all orders; `keys` of its assignment."""

    def opened(**assignment):
        rules = {"scheme": "all_orders", "seed": 3, **assignment}
        frozen = small_protocol(tmp_path, [CROSSED], query_set=str(twenty_queries), assignment=rules)
        with database.transaction() as s:
            return create_study(s, files, frozen, name="Crossed", created_by=None)

    return opened


def joined(database, files, study, n=1, **named):
    with database.transaction() as s:
        return [join_study(s, study, language="en", files=files, **named)[0] for _ in range(n)]


def held(database, study, *, now=None, simulated=False):
    with database.session() as s:
        table = assignment_table(s, study, thaw(study).protocol, now=now or utc_now(), simulated=simulated)
    return [line.held for line in table]


def test_a_session_keeps_its_place_and_its_plan_follows_it(database, files, crossed):
    (session,) = joined(database, files, crossed())
    given = session.assignment
    assert given["scheme"] == "all_orders"
    assert given["rows"] == 6
    assert sorted(given["order"]) == sorted(VIEWS)
    assert [step["block"] for step in session.plan if step["kind"] == "trial"][::3] == given["order"]


def test_bots_and_people_fill_the_orders_each_for_themselves(database, files, crossed):
    study = crossed()
    joined(database, files, study, 6)
    joined(database, files, study, 7, simulated=True)
    assert held(database, study) == [1] * 6
    assert sorted(held(database, study, simulated=True)) == [1, 1, 1, 1, 1, 2]


def test_people_who_join_at_the_same_moment_get_different_orders(database, files, crossed):
    study = crossed()
    failed = []

    def join() -> None:
        try:
            joined(database, files, study)
        except Exception as problem:
            failed.append(problem)

    threads = [threading.Thread(target=join) for _ in range(12)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed
    assert held(database, study) == [2] * 6


def test_a_place_is_freed_by_leaving_and_by_silence_but_not_by_an_exclusion(database, files, crossed):
    study = crossed(lease_hours=2)
    people = joined(database, files, study, 6)
    with database.transaction() as s:
        s.get_one(Participant, people[0].participant_id).withdrawn_at = utc_now()
        s.get_one(Participant, people[1].participant_id).excluded_at = utc_now()
        s.get_one(Session, people[2].id).state = "completed"
        s.get_one(Session, people[3].id).last_seen_at = utc_now() - timedelta(hours=3)
    by_row = held(database, study)
    assert by_row[people[0].assignment["row"]] == 0
    assert by_row[people[1].assignment["row"]] == 1
    assert by_row[people[2].assignment["row"]] == 1
    assert by_row[people[3].assignment["row"]] == 0
    again = {one.assignment["row"] for one in joined(database, files, study, 2)}
    assert again == {people[0].assignment["row"], people[3].assignment["row"]}
    with database.session() as s:
        table = assignment_table(s, study, thaw(study).protocol, now=utc_now())
    lines = {line.row: line for line in table}
    assert lines[people[0].assignment["row"]].attrition == 1.0
    assert lines[people[2].assignment["row"]].attrition == 0.0
    assert lines[people[3].assignment["row"]].counts["lapsed"] == 1


def test_an_exclusion_frees_a_place_where_the_protocol_said_so(database, files, crossed):
    study = crossed(excluded="free_place")
    (person,) = joined(database, files, study)
    with database.transaction() as s:
        s.get_one(Participant, person.participant_id).excluded_at = utc_now()
    assert held(database, study) == [0] * 6


def test_the_same_study_gives_the_same_orders_again():
    first = [next_row([0] * 6, seed=4) for _ in range(3)]
    assert len(set(first)) == 1
    assert {next_row([0] * 6, seed) for seed in range(30)} == set(range(6))
    assert session_seed(4, "P1") == session_seed(4, "P1")


def test_a_scheme_without_conditions_and_too_many_orders_are_refused(tmp_path):
    with pytest.raises(ProtocolError, match="needs a block with 'each' or 'one_of'"):
        small_protocol(tmp_path, [BLOCK], assignment={"scheme": "williams"})
    factors = {"view": VIEWS, "told": ["a", "b", "c"]}
    crossed = {"block": {"each": factors, "trials": [{"queries": {"count": 1}}]}}
    assert len(design_of(small_protocol(tmp_path, [crossed], assignment={"scheme": "williams"}).protocol).rows) == 18
    with pytest.raises(ProtocolError, match="362880 different orders, more than 5040; use latin_square"):
        small_protocol(tmp_path, [crossed], assignment={"scheme": "all_orders"})


def test_choosing_by_the_answers_is_refused_where_conditions_must_show_the_same(tmp_path):
    block = {"block": {"each": VIEWS, "trials": [{"queries": {"count": 3, "choose": "information"}}]}}
    with pytest.raises(ProtocolError, match="must be random, because this protocol's blocks show the same queries"):
        small_protocol(tmp_path, [block])
    stop = {"count": 9, "stop": {"at_least": 2}}
    with pytest.raises(ProtocolError, match=r"stop.*needs queries that are chosen"):
        small_protocol(tmp_path, [{"block": {"each": VIEWS, "trials": [{"queries": stop}]}}])


def test_every_trial_of_a_condition_is_marked_with_it(database, files, crossed):
    study = crossed()
    (session,) = joined(database, files, study)
    with database.session() as s:
        plan = s.scalars(select(Session.plan).where(Session.id == session.id)).one()
    first = next(step for step in plan if step["kind"] == "trial")
    assert first["key"] == f"block.{first['block']}.01"
    assert first["view"] == first["block"]
