"""A bot walks a protocol that has everything: checks, conditions, probes, limits, breaks, skips, appointments."""

from __future__ import annotations

from sqlalchemy import select

from desirepath.store.models import Response, Session, Trial
from desirepath.study.simulated.in_process import walk_in_process
from desirepath.study.studies import create_study
from tests.study.small_protocol import VIEWS, small_protocol

PURPOSES = {"training": {"en": "Learn?"}, "open_data": {"en": "Publish?"}}
STAGES = [
    {"questionnaire": {"use": "about"}},
    {"comprehension": {"use": "quiz"}},
    {
        "block": {
            "each": VIEWS,
            "before": [{"instruction": {"text": "instruction.md"}}],
            "trials": [
                {"queries": {"count": 1, "role": "practice"}},
                {"queries": {"count": 2, "probes": {"repeat": 1, "swap": 1}}},
            ],
            "after": [{"questionnaire": {"use": "rating"}}],
            "between": [{"break": {"text": "pause.md", "at_least_s": 60}}],
            "attention_checks": 1,
            "viewing": {"choice_limit_s": 10},
        }
    },
    {"appointment": {"text": "come_back.md", "after_days": 1, "within_days": 3}},
    {"instruction": {"text": "instruction.md"}},
    {"questionnaire": {"use": "order"}, "when": {"questionnaire": "about", "item": "age", "at_least": 18}},
]


def test_bots_finish_it_and_leave_every_sort_of_row(tmp_path, database, files, twenty_queries):
    consent = {"consent": {"text": "consent.md", "version": "1", "purposes": PURPOSES}}
    frozen = small_protocol(
        tmp_path, STAGES, query_set=str(twenty_queries), consent_stage=consent, assignment={"scheme": "latin_square"}
    )
    with database.transaction() as s:
        study = create_study(s, files, frozen, name="Everything", created_by=None)
    done = walk_in_process(database, files, study, 2)
    assert done["completed"] == 2
    with database.session() as s:
        sessions = s.scalars(select(Session).order_by(Session.created_at)).all()
        trials = s.scalars(select(Trial)).all()
        kinds = set(s.scalars(select(Response.kind)))
    assert [one.appointment for one in sessions] == [1, 2, 1, 2]
    assert len({tuple(one.assignment["order"]) for one in sessions}) == 2
    assert sessions[0].assignment == sessions[1].assignment
    assert {"attention", "comprehension", "break", "questionnaire", "preference", "consent"} <= kinds
    by_id = {trial.id: trial for trial in trials}
    probes = [trial for trial in trials if trial.role in ("repeat", "swap")]
    assert len(probes) == 2 * 3 * 2
    for probe in probes:
        before = by_id[probe.probe_of]
        assert (before.query_id, before.block, before.role) == (probe.query_id, probe.block, "regular")
        assert (before.sides_swapped == probe.sides_swapped) == (probe.role == "repeat")
