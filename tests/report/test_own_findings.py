"""The own policy against others: people are the units, or the lent policies; the text says what the tests say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from scipy import stats

from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.findings import Findings, analyse
from desirepath.report.report_text import sections
from desirepath.report.study_data import Choice, Comparison, Guess, ParticipantRow, StudyData

PLAN = AnalysisPlan(metrics=())


def nothing(trajectory: str) -> None:
    raise LookupError(trajectory)


def compared(code: str, against: str, own: int, other: int, lent: str | None = None) -> list[Comparison]:
    return [Comparison(code, "own", against, False, lent)] * own + [
        Comparison(code, against, "own", False, lent)
    ] * other


def found(
    comparisons: list[Comparison],
    plan: AnalysisPlan = PLAN,
    guesses: tuple[Guess, ...] = (),
    refused: tuple[str, ...] = (),
    further: dict[str, int] | None = None,
) -> Findings:
    """refused: of each person who compares nothing, why; further: answers of those who were asked on."""
    codes = list(dict.fromkeys(one.person for one in comparisons))
    people = [ParticipantRow(code, False, None, False, "completed", (), own_policy="shown") for code in codes]
    people += [
        ParticipantRow(f"R-{k}", False, None, False, "completed", (), own_policy=why) for k, why in enumerate(refused)
    ]
    people = [replace(one, further=(further or {}).get(one.code, 0)) for one in people]
    asked = [Choice(one.code, "v", "v", "1", "regular", "a", "b", "a", 1.0) for one in people]
    data = StudyData("By hand", "1", {}, "", [], people, asked, [], comparisons, guesses=guesses)
    return analyse(data, nothing, plan=plan)


def verdict(of: Findings) -> str:
    (part,) = (part for part in sections(of, [], Path()) if part.title == "Does it personalise?")
    return " ".join(part.sentences)


def test_both_arms_are_tested_and_corrected_together() -> None:
    answers = [one for k in range(9) for one in compared(f"P-{k}", "base", 3, 0)]
    answers += [one for k in range(9) for one in compared(f"P-{k}", "other", 2, 1, f"policy-{k}")]
    base, other = found(answers).personalised
    assert (base.against, base.answers, base.share.mean, base.test.test) == ("base", 27, 1.0, "Sign test")
    assert (other.against, other.answers, other.clusters, other.people) == ("other", 27, 9, 9)
    raw = stats.binomtest(9, 9).pvalue
    assert (base.test.p, base.test.p_corrected) == pytest.approx((raw, 2 * raw))
    assert other.test.p_corrected == pytest.approx(2 * raw)
    assert base.share.low > 0.6
    assert other.share.mean == pytest.approx(2 / 3)
    uncorrected = found(answers, AnalysisPlan(metrics=(), correction="none")).personalised[0].test
    assert uncorrected.p_corrected == uncorrected.p


def test_signed_ranks_count_by_how_much() -> None:
    """Seven people, two of whom barely prefer the other policy and five who always take their own."""
    answers = [one for k in range(5) for one in compared(f"P-{k}", "base", 5, 0)]
    answers += [one for k in (5, 6) for one in compared(f"P-{k}", "base", 2, 3)]
    (sign,) = found(answers).personalised
    (ranks,) = found(answers, AnalysisPlan(metrics=(), own="signed_ranks")).personalised
    assert (sign.test.test, sign.beside.test) == ("Sign test", "Wilcoxon signed-rank")
    assert (ranks.test.test, ranks.beside.test) == ("Wilcoxon signed-rank", "Sign test")
    assert sign.test.p == pytest.approx(stats.binomtest(5, 7).pvalue)
    assert ranks.test.p == sign.beside.p
    assert ranks.test.statistic == 3.0  # the two smallest of seven ranks are against
    assert ranks.test.direction == "the own policy is mostly chosen over the base policy"


def test_who_was_not_shown_a_policy_as_theirs_is_counted_and_said() -> None:
    """Twelve people, nine of whom the gate lets compare: the tests are of nine, and the text says so."""
    answers = [one for k in range(9) for one in compared(f"P-{k}", "base", 3, 0)]
    of = found(answers, refused=("not_surely_better", "gate_not_passed", "not_surely_better"))
    assert of.own_policies == {"shown": 9, "not_surely_better": 2, "gate_not_passed": 1}
    assert of.personalised[0].people == 9
    said = verdict(of)
    assert "9 of 12 people for whom a policy was to be made were shown it as theirs, and only they compare" in said
    assert "3 were not: 2 because it was not surely better for that very person, 1 because it did not pass" in said
    assert "not about everybody" in said
    assert "All 9 people for whom a policy was to be made were shown one as theirs" in verdict(found(answers))
    nobody = verdict(found([], refused=("not_surely_better", "stranger")))
    assert "0 of 2 people" in nobody
    assert "1 for another reason (stranger)" in nobody
    nothing_made = replace(of, personalised=[], own_policies={})
    assert not any(part.title == "Does it personalise?" for part in sections(nothing_made, [], Path()))


def test_who_was_asked_on_and_how_many_answers_more_they_gave_is_said() -> None:
    answers = [one for k in range(3) for one in compared(f"P-{k}", "base", 3, 0)]
    assert "asked on" not in verdict(found(answers))
    said = verdict(found(answers, further={"P-0": 10, "P-2": 5}))
    assert "2 of 3 people were asked on" in said
    assert "15 further answers in all; 5 further answers: P-2; 10 further answers: P-0" in said
    nobody_compared = found([], refused=("not_surely_better",), further={"R-0": 1})
    assert "1 of 1 people was asked on" in verdict(nobody_compared)
    assert "1 further answer: R-0" in verdict(nobody_compared)


def test_two_people_have_both_tests_and_one_has_the_sign_test_only() -> None:
    both = [one for k in range(2) for one in compared(f"P-{k}", "base", 3, k)]
    assert found(both).personalised[0].beside.test == "Wilcoxon signed-rank"
    assert found(both[:3]).personalised[0].beside.test == "Sign test"


def test_people_who_were_lent_the_same_policy_are_one() -> None:
    """Ten people, two lent policies: one is bad, one is good. By people 8 of 10 prefer their own; by policies
    nothing is known."""
    answers = [one for k in range(8) for one in compared(f"P-{k}", "other", 3, 0, "bad")]
    answers += [one for k in (8, 9) for one in compared(f"P-{k}", "other", 0, 3, "good")]
    of = found(answers)
    (other,) = of.personalised
    assert (other.people, other.clusters, other.test.n, other.test.p) == (10, 2, 2, 1.0)
    assert other.share.mean == 0.5
    assert not other.test.possible()
    assert "10 people were lent 2 different policies" in verdict(of)
    assert "none could be with so few people" in verdict(of)
    apart = [one for k in range(10) for one in compared(f"P-{k}", "other", 3 * (k < 8), 3 * (k >= 8), f"policy-{k}")]
    assert found(apart).personalised[0].test.n == 10
    assert "were lent" not in verdict(found(apart))


@pytest.mark.parametrize(
    ("base", "other", "said"),
    [
        ((3, 0), (3, 0), "is not only what everybody likes"),
        ((3, 0), (0, 3), "preferred the policy that another participant's answers made to their own"),
        ((3, 0), (None, None), "nobody compared it with a policy"),
        ((0, 3), (1, 1), "The own policy was not shown to be preferred"),
        ((3, 0), (1, 1), "preferred to the base policy, but was not shown"),
    ],
)
def test_the_text_says_no_more_than_the_tests(base: tuple, other: tuple, said: str) -> None:
    answers = [one for k in range(9) for one in compared(f"P-{k}", "base", *base)]
    if other[0] is not None:
        answers += [one for k in range(9) for one in compared(f"P-{k}", "other", *other, f"policy-{k}")]
    of = found(answers)
    assert said in verdict(of)
    own, others = of.personalised[0], of.personalised[-1]
    assert own.preferred(0.05) == (base[0] > base[1])
    assert others.preferred(0.05) == ((other[0] or base[0]) > (other[1] if other[0] is not None else base[1]))


def test_stand_ins_are_told_and_show_no_other_participant() -> None:
    """Three of nine were lent a simulated person's policy: said. All nine: it does not show that it is personal."""
    base = [one for k in range(9) for one in compared(f"P-{k}", "base", 3, 0)]
    other = [one for k in range(9) for one in compared(f"P-{k}", "other", 3, 0, f"policy-{k}")]
    some = [replace(one, stand_in=one.person < "P-3") for one in other]
    of = found(base + some)
    assert [one.stand_ins for one in of.personalised] == [0, 3]
    assert "3 of the people who were lent another's policy were lent one made from a simulated" in verdict(of)
    assert "is not only what everybody likes" in verdict(of)
    everybody = verdict(found(base + [replace(one, stand_in=True) for one in other]))
    assert "made from a simulated person's" in everybody
    assert "does not show that it is personal" in everybody
    assert "is not only what everybody likes" not in everybody
    assert "stand-in" not in verdict(found(base + other))


def test_the_verdict_names_what_the_own_policy_is_preferred_to() -> None:
    neutral = [one for k in range(9) for one in compared(f"P-{k}", "neutral", 3, 0)]
    other = [one for k in range(9) for one in compared(f"P-{k}", "other", 1, 1, f"policy-{k}")]
    told = verdict(found(neutral + other))
    assert "is preferred to the conditioned policy without preferences, but was not shown" in told
    base = [one for k in range(9) for one in compared(f"P-{k}", "base", 1, 1)]
    assert "the base policy, but" not in verdict(found(base + neutral + other))


def test_it_is_said_how_many_earlier_people_stood_behind_their_policy_and_what_successive_people_share() -> None:
    before = [5, 6, 30, None, 12, 12, 12]
    base = [one for k in range(7) for one in compared(f"P-{k}", "base", 2, 1)]
    answers = [
        replace(one, earlier=people)
        for k, people in enumerate(before)
        for one in compared(f"P-{k}", "population", 2, 1)
    ]
    of = found(base + answers)
    assert [one.earlier for one in of.personalised] == [(), (5, 6, 30, 12, 12, 12)]
    told = verdict(of)
    assert "a median of 12 earlier people (5 to 30) (known of 6 of 7 people)" in told
    assert "successive ones meet nearly the same opponent" in told
    assert "opponent" not in verdict(found(base))
    unknown = verdict(found([replace(one, earlier=None) for one in answers]))
    assert "do not say how many people stood behind it" in unknown


def test_a_neutral_arm_is_a_comparison_of_its_own() -> None:
    answers = [one for k in range(9) for one in compared(f"P-{k}", "base", 3, 0) + compared(f"P-{k}", "neutral", 3, 0)]
    assert [one.against for one in found(answers).personalised] == ["base", "neutral"]
    assert "the conditioned policy without preferences" in verdict(found(answers))


def test_the_guess_is_reported_against_chance() -> None:
    answers = [one for k in range(10) for one in compared(f"P-{k}", "base", 2, 1)]
    guesses = tuple(Guess(f"P-{k}", k != 0) for k in range(10))
    of = found(answers, guesses=(*guesses, Guess("stranger", True)))
    assert of.guessed is not None
    assert (of.guessed.right, of.guessed.people) == (9, 10)
    assert of.guessed.test.p == pytest.approx(stats.binomtest(9, 10).pvalue)
    assert of.guessed.test.effect == pytest.approx(0.4)
    assert of.guessed.test in of.tests
    assert "9 of 10 guessed" in verdict(of)
    assert "more are right than by chance" in verdict(of)
    assert found(answers).guessed is None
