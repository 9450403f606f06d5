"""Table 7.3 from measured policies."""

from __future__ import annotations

from backend.learning.evaluate import evaluate_policy
from backend.learning.shipped import load_policy
from backend.report.policies import BASE, MEANS, PERCENT, PolicyRow, policies_section


def test_the_table_holds_every_number_with_its_interval() -> None:
    measured = evaluate_policy(load_policy("study_room/base"), n=30)
    rows = [
        PolicyRow("top_down", "a" * 64, measured, answers=775, accuracy=0.81, passed=False),
        PolicyRow(BASE, "study_room/base", measured),
    ]
    section = policies_section(rows)
    (table,) = section.tables
    assert list(table.heads) == ["", "top down", BASE]
    assert len(table.rows) == len(PERCENT) + len(MEANS) + 2
    low, high = measured["intervals"]["success_rate"]
    success = next(row for row in table.rows if row[0] == "success (%)")
    assert success[1] == success[2] == f"{100 * measured['success_rate']:.1f} [{100 * low:.1f}, {100 * high:.1f}]"
    assert list(table.rows[-2]) == ["answers learned from", "775", "–"]
    assert "30 fresh scenes" in section.sentences[0]
    assert section.sentences[1].endswith("nobody is shown it: top down.")
    assert rows[0].row()["min_human_distance_m_low"] == measured["intervals"]["min_human_distance_m"][0]
