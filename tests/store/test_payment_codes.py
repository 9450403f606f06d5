"""What of a protocol is worth money, taken out of it."""

from __future__ import annotations

import yaml

from desirepath.store.payment_codes import REMOVED, changes_without, data_without, yaml_without

PROTOCOL = """\
protocol: stages       # also the code of who is screened out: only the code itself is hidden
screen_out: {text: sorry.md, completion_code: stages}
stages:
  - debriefing:
      text: end.md
      completion_code: !!str &code 'CODE-77'   # paid
      return_url: "https://example.org/?cc=CODE-77"
  - debriefing: {text: end.md, completion_code: *code}
  - debriefing: {text: end.md, completion_code: random, return_url: null}
"""


def test_only_the_values_themselves_are_replaced() -> None:
    hidden = yaml_without(PROTOCOL)
    assert hidden == PROTOCOL.replace("completion_code: stages}", 'completion_code: "REMOVED"}').replace(
        "!!str &code 'CODE-77'", '&code "REMOVED"'
    ).replace('"https://example.org/?cc=CODE-77"', '"https://removed.invalid/"')
    assert yaml.safe_load(hidden) == data_without(yaml.safe_load(PROTOCOL))
    assert yaml_without(hidden) == hidden  # so that a data set that was imported is exported to the same bytes


def test_changes_tell_that_a_code_changed_but_no_code() -> None:
    field = "stages.debriefing.completion_code"
    changes = [
        {"field": field, "before": "random", "after": "NEW-9"},
        {"field": "title.en", "before": "a", "after": "b"},
    ]
    code, title = changes_without(changes)
    assert (code["before"], code["after"]) == ("random", REMOVED["completion_code"])
    assert title == changes[1]
