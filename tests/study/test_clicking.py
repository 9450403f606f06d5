"""Who clicks one letter, or faster than anybody compares, teaches nothing, is told so kindly, and is flagged."""

from __future__ import annotations

import pytest

from desirepath.study.personalising.clicking import is_too_fast, position_bias
from desirepath.web.lab import monitoring
from tests.study.test_meet_your_robot import COMPARISON, MEET, TRAIN
from tests.study.walking import session_row

EIGHT = {"block": {"view": "top_down", "trials": [{"queries": {"count": 8}}]}}


@pytest.mark.parametrize(
    ("letters", "found"),
    [("a" * 15, True), ("b" * 8, True), ("a" * 13 + "bb", True), ("a" * 12 + "bbb", False), ("a" * 7, False)],
)
def test_position_bias_is_a_count_that_chance_hardly_gives(letters, found):
    assert position_bias(letters).is_found == found


def test_its_p_is_the_exact_binomial_one():
    from scipy import stats

    for letters in ("a" * 15, "ab" * 5, "aab" * 4, "b" * 9 + "a"):
        found = position_bias(letters)
        assert found.p == pytest.approx(stats.binomtest(found.times, found.of).pvalue)
    assert (position_bias("").of, position_bias("").is_found) == (0, False)


def test_a_slight_lean_is_no_bias_however_many_answers_there_are():
    assert position_bias("a" * 120 + "b" * 80).p < 0.01
    assert not position_bias("a" * 120 + "b" * 80).is_found


def answered(walk, choose, *, thinks_s: float = 2.0, train=TRAIN, compare=COMPARISON, pairs: int = 8):
    """At the page after so many of eight pairs, simulated by hand."""
    walker = walk(EIGHT, train, compare, MEET)
    for number in range(pairs):
        key = walker.view.key
        walker.watch(key)
        walker.later(thinks_s)
        walker.submit(key, {"choice": choose(number)})
    return walker


@pytest.mark.parametrize("letter", ["a", "b"])
def test_always_the_same_letter_teaches_nothing_and_is_said_kindly(walk, letter):
    walker = answered(walk, lambda number: letter)
    assert session_row(walker).personalisation == "one_sided"
    assert walker.view.kind == "debriefing", "nothing is waited for, nothing compared, no empty step"
    about = walker.view.payload["about"]
    assert about == {"outcome": "one_sided", "learns_from": "answers", "answers": 8, "letter": letter, "times": 8}
    with walker.database.session() as s:
        (seen,) = monitoring.signs(s, walker.session.study_id).values()
    assert (seen.flags, seen.sides.letter, seen.sides.times, seen.sides.of) == (("one_sided",), letter, 8, 8)


def test_who_never_takes_the_time_to_compare_teaches_nothing(walk):
    walker = answered(walk, lambda number: "ab"[number % 2], thinks_s=0.2)
    assert (session_row(walker).personalisation, walker.view.kind) == ("too_fast", "debriefing")


@pytest.mark.parametrize(("pairs", "flags"), [(1, ()), (2, ("too_fast",)), (7, ("too_fast",))])
def test_who_chooses_too_fast_is_seen_early_with_the_count(walk, pairs, flags):
    walker = answered(walk, lambda number: "ab"[number % 2], thinks_s=0.2, pairs=pairs)
    with walker.database.session() as s:
        (seen,) = monitoring.signs(s, walker.session.study_id).values()
    assert (seen.flags, seen.hasty) == (flags, (len(flags) * pairs, pairs))


def test_no_difference_in_no_time_is_no_comparing_either(walk):
    eight = {"block": {**EIGHT["block"], "answers": {"no_difference": True}}}
    walker = walk(eight, TRAIN, COMPARISON, MEET)
    for number in range(8):
        key = walker.view.key
        walker.watch(key)
        walker.later(0.2)
        walker.submit(key, {"degree": "no_difference"} if number % 4 else {"choice": "ab"[number % 2]})
    assert session_row(walker).personalisation == "too_fast"
    with walker.database.session() as s:
        (seen,) = monitoring.signs(s, walker.session.study_id).values()
    assert (seen.flags, seen.hasty) == (("too_fast",), (8, 8))


def test_nobody_guesses_about_a_comparison_that_was_not_shown(walk):
    """Where further pairs might have been asked, too."""
    asking_on = {"train": {**TRAIN["train"], "ask_on": {"at_most": 4, "each": 2}}}
    guessing = {"comparison": {**COMPARISON["comparison"], "guess": True}}
    walker = answered(walk, lambda number: "ab"[number % 2], thinks_s=0.2, train=asking_on, compare=guessing)
    assert (session_row(walker).personalisation, walker.view.kind) == ("too_fast", "debriefing")


def test_who_compares_is_learned_from(walk):
    walker = answered(walk, lambda number: "ab"[number % 2])
    assert (session_row(walker).personalisation, walker.view.kind) == (None, "wait")


def test_few_fast_choices_are_nothing():
    assert not is_too_fast([0.1] * 4)
    assert is_too_fast([0.1] * 4 + [3.0] * 4)
    assert not is_too_fast([0.1] * 3 + [3.0] * 4)
