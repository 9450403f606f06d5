"""Table 7.3 from measured policies."""

from __future__ import annotations

from desirepath.learning.policies.evaluate import evaluate_policy
from desirepath.learning.policies.shipped import load_policy
from desirepath.report.policy_table import BASE, MEANS, PERCENT, PolicyRow, policies_section


def test_the_table_holds_every_number_with_its_interval() -> None:
    measured = evaluate_policy(load_policy("study_room/base"), n=30)
    rows = [
        PolicyRow("top_down", "a" * 64, measured, answers=775, accuracy=0.81, passed=False),
        PolicyRow(BASE, "study_room/base", measured),
    ]
    section = policies_section(rows)
    (table,) = section.tables
    assert list(table.heads) == ["", "top down", BASE]
    assert len(table.rows) == len(PERCENT) + len(MEANS) + 4
    low, high = measured["intervals"]["success_rate"]
    success = next(row for row in table.rows if row[0] == "success (%)")
    assert success[1] == success[2] == f"{100 * measured['success_rate']:.1f} [{100 * low:.1f}, {100 * high:.1f}]"
    crossings = next(row for row in table.rows if row[0] == "self-intersections per rollout")
    low, high = measured["intervals"]["self_intersections"]
    assert crossings[2] == f"{measured['self_intersections']:.2f} [{low:.2f}, {high:.2f}]"
    assert rows[1].row()["self_intersections"] == measured["self_intersections"]
    assert list(table.rows[-4]) == ["answers learned from", "775", "–"]
    assert "30 fresh scenes" in section.sentences[0]
    assert section.sentences[1].endswith("nobody is shown it: top down.")
    assert rows[0].row()["min_human_distance_m_low"] == measured["intervals"]["min_human_distance_m"][0]


def test_the_report_says_which_reward_model_predicts_a_views_answers_better() -> None:
    measured = evaluate_policy(load_policy("study_room/base"), n=20)

    def row(model: str, accuracy: float, log_likelihood: float) -> PolicyRow:
        held_out = {"accuracy": accuracy, "low": accuracy - 0.03, "high": accuracy + 0.03}
        held_out |= {"log_likelihood": log_likelihood, "folds": 3, "scenes": 400}
        return PolicyRow("immersive", model, measured, model=model, answers=775, held_out=held_out)

    section = policies_section([row("interface", 0.81, -0.45), row("weights", 0.95, -0.17)])
    assert section.sentences[1].startswith(
        "Immersive: preference weights predicts answers about scenes it did not see better (-0.17 per answer against "
        "-0.45 of chapter 7's network; a coin has -0.69)"
    )
    assert section.tables[0].rows[-2][1:] == ["81 % [78, 84]", "95 % [92, 98]"]
