"""The manual's pages that the product writes: what stands in `docs` is what would be written now."""

from __future__ import annotations

import pytest

from desirepath.installed import DOCS
from desirepath_experiments.manual import PAGES
from desirepath_experiments.results_page import ALL, Stored, _median, percent


@pytest.mark.parametrize("name", PAGES)
def test_a_written_page_is_what_would_be_written_now(name: str) -> None:
    assert (DOCS / f"{name}.md").read_text("utf-8") == PAGES[name](), "run `make docs`"


def test_every_result_has_one_number_an_interval_and_the_command_that_made_it() -> None:
    for one in (result() for result in ALL):
        assert all((one.number, one.interval, one.worst, one.over)), one.what
        assert one.stored.command.startswith("desirepath "), one.what


def test_the_worst_is_a_units_median_and_the_interval_is_over_units() -> None:
    units = {name: [share, share, 1.0] for name, share in zip("abcdefghi", (0.1, *[0.5] * 8), strict=True)}
    told = _median("shares", units, percent, "nine", Stored("", {}))
    assert (told.number, told.worst, told.interval) == ("50 %", "10 % (a)", "50 to 50 %")
    few = _median("seconds", {"seed 0": [1.0], "seed 1": [3.0]}, str, "two", Stored("", {}), most=True)
    assert (few.number, few.worst, few.interval) == ("2.0", "3.0 (seed 1)", "1.0 to 3.0")
