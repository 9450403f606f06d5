"""What chapters declare as data: budgets, printed tables, reports."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from desirepath_experiments.reproduction.driver import NAMES, chapter_named, tasks_in
from desirepath_experiments.reproduction.published import published
from desirepath_experiments.reproduction.reports import report_of, sentences, write_compared


@pytest.mark.parametrize("name", NAMES)
def test_every_chapter_says_how_much_what_was_printed_and_what_it_tells(name: str) -> None:
    chapter = chapter_named(name)
    assert {"small", "full"} <= set(chapter.budgets)
    assert all(budget.name == named for named, budget in chapter.budgets.items())
    assert len(tasks_in(chapter.plan(chapter.budgets["small"], **chapter.options))) > 2
    assert len({section.title for section in report_of(name).sections}) > 2
    for table in published(name).tables.values():
        assert table.lines
        for printed in table.rows.values():
            assert set(printed) <= set(table.units)


def test_a_sentence_that_comes_to_nothing_is_left_out_and_one_text_may_be_several() -> None:
    texts = ["{% if few %}Few.{% endif %}", "{% for n in numbers %}{{ n | f('.1f') }} m.{{ new }}{% endfor %}"]
    assert sentences(texts, {"few": False, "numbers": [1, None]}) == ["1.0 m.", "- m."]


def test_every_printed_number_stands_beside_ours(tmp_path: Path) -> None:
    measured = {key: {"mean": float("nan")} for key in ("collision", "timeout", "time_s")}
    rates = {
        "ours": dict.fromkeys(("published", "homes", "no_walls", "no_icp"), {"success": {"mean": 90.0}} | measured)
    }
    write_compared(tmp_path / "compared.csv", "pedestrians", {"rates": rates, "budget": SimpleNamespace()})
    lines = (tmp_path / "compared.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "table,condition,measure,unit,printed,here,compared,met"
    assert "table_4_1,ours,success,%,86.2,90.0,at least,yes" in lines
    assert "table_4_1,ours,time_s,s,17.7,,," in lines  # nobody arrived
    assert "table_4_1,b1,success,%,78.4,,," in lines  # not computed
    assert len(lines) == 1 + 7 * 4 + 4 + 2
