"""A protocol from outside cannot keep the server busy: what is too much is refused where it is read, in words."""

from __future__ import annotations

import pytest

from desirepath.grammar.source import ProtocolError, Source
from desirepath.installed import PROTOCOLS
from desirepath.study.protocol.freezing import freeze_text

QUICK = (PROTOCOLS / "quick_preference_study.yaml").read_text()
PAGE = "  - instruction: {text: texts/instruction.md}\n"
ALIASES = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{here}: &{here} [{', '.join([f'*{before}'] * 9)}]\n" for before, here in zip("abcdefgh", "bcdefghi", strict=True)
)

REFUSED = {
    "nine levels of aliases": (ALIASES, "aliases filled in"),
    "an alias of itself": ("stages: &all [*all]\n", "stands within what it names"),
    "a mapping merged into itself": ("stages: &all {<<: *all}\n", "stands within what it names"),
    "900 lists in each other": (f"stages: {'[' * 900}{']' * 900}\n", "stand within each other"),
    "100,000 lists that never end": (f"stages: {'[' * 100_000}", "stand within each other"),
    "a long file": ("# " + "x" * 600_000, "characters"),
    "many values": (f"stages: [{'1, ' * 30_000}]", "keys and values"),
    "a number no database holds": (f"version: 1{'0' * 30}", "too large"),
    "a number nobody reads": (f"version: {'9' * 100_000}", "too large"),
    "a number without end": ("minutes: .inf", "too large"),
    "a number that is none": ("minutes: .nan", "too large"),
    "a day": ("minutes: !!timestamp 2026-02-31", "timestamp"),
    "a word that is no number": ("minutes: !!int x", "'x'"),
    "nothing that is a number": ("minutes: !!int ''", "holds a value that is none"),
    "no time stamp": ("minutes: !!timestamp 5", "timestamp"),
    "a Python object": ("minutes: !!python/name:os.system x", "python/name"),
    "a list as a key": ("? [a]\n: b", "unhashable"),
    "a character no text has": ("minutes: '\x00'", "not valid YAML"),
    "half a character": ("minutes: '\ud800'", "surrogates"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_that_is_too_much_is_refused_before_anything_is_built(name: str):
    text, says = REFUSED[name]
    with pytest.raises(ProtocolError) as refused:
        Source("protocol.yaml", text)
    assert says in str(refused.value)


MANY_TRIALS = QUICK.replace("- queries: {count: 15", "- queries: {count: 200}\n        " * 9 + "- queries: {count: 200")
LETTERS = "[q, r, s, t, u, v, w, x]"
CROSSED = QUICK.replace("view: top_down", f"each: {{view: [top_down, immersive], a: {LETTERS}, b: {LETTERS}}}", 1)


@pytest.mark.parametrize(
    ("text", "field", "says"),
    [
        (QUICK + PAGE * 3_000, "stages[100]", "has 3,009 stages; a protocol has at most 100"),
        (QUICK.replace("version: 2\n", "version: 3000000000\n"), "version", "at most 2147483647"),
        (MANY_TRIALS, "stages[4].block.trials", "brings a participant to 2,001 trials"),
        (CROSSED, "stages[4].block.each", "makes 128 conditions"),
    ],
    ids=["stages", "version", "trials", "conditions"],
)
def test_a_protocol_that_asks_too_much_is_refused_before_it_is_planned(text: str, field: str, says: str):
    with pytest.raises(ProtocolError) as refused:
        freeze_text(text)
    (problem,) = refused.value.problems
    assert problem.field == field
    assert says in problem.message


def test_aliases_and_merged_keys_are_still_read():
    read = Source("protocol.yaml", "a: &a {x: 1, y: 2}\nb: {<<: *a, x: 3}\nc: [*a, *a]\n")
    assert read.data["b"] == {"x": 3, "y": 2}
    assert read.data["c"] == [{"x": 1, "y": 2}] * 2
    assert read.line(("b", "x")) == 2


def test_thousands_of_errors_are_told_as_the_first_hundreds() -> None:
    text = QUICK + "".join(f"key_{n}: {n}\n" for n in range(8_000))
    with pytest.raises(ProtocolError) as refused:
        freeze_text(text)
    assert len(refused.value.problems) == 200
