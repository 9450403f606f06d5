"""The own policy against others in blind comparisons, and who guessed which one was theirs. Pure.

What was chosen among queries is `choice_findings.py`'s, everything together `findings.py`'s.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from desirepath.analysis.choices import binomial_test, share_over_people, sign_test
from desirepath.analysis.repeated_measures import wilcoxon
from desirepath.analysis.tested import Mean, Tested, correct_tests
from desirepath.report.analysis_plan import AnalysisPlan
from desirepath.report.study_data import Comparison, Guess

ARMS = {
    "base": "the base policy",
    "neutral": "the conditioned policy without preferences",
    "population": "the policy by what earlier participants want",
    "other": "another participant's policy",
}
"""What the own policy can be compared with, in the report's order."""


@dataclass(frozen=True)
class Personalised:
    """Own policy against another arm, over people. share: of a person's choices.

    test: the one that the plan declares, corrected; beside: the other of sign test and signed ranks, uncorrected and
    for reading only. clusters: independent units; people who were lent the same policy are one. answers: comparisons,
    look_alike: of them those whose rollouts look alike; they are counted. stand_ins: people whose opponent was made
    from a simulated person's answers, because no other participant's was ready. earlier: of each person, as far as is
    known, how many stood behind the policy by what earlier participants want.
    """

    against: str
    share: Mean
    test: Tested
    beside: Tested
    people: int
    clusters: int
    answers: int
    look_alike: int
    stand_ins: int = 0
    earlier: tuple[int, ...] = ()

    def preferred(self, alpha: float) -> bool:
        """Whether the own policy was shown to be preferred: a significant test in its favour."""
        return self.test.significant(alpha) and self.test.effect > 0


def compare_own(comparisons: Sequence[Comparison], plan: AnalysisPlan) -> list[Personalised]:
    """The own policy against each arm, p corrected over the arms.

    Answers of one person depend on each other, and so do those of people who were lent the same policy of another's
    (they share what is good or bad about it): units are people, or the people of one lent policy together.
    """
    of_arm = [(against, of_opponent) for against in ARMS if (of_opponent := own_against(comparisons, against))]
    raw = [_tests(of_opponent, against, plan) for against, of_opponent in of_arm]
    tests = correct_tests([declared for declared, _ in raw], plan.correction)
    return [
        Personalised(
            against=against,
            share=_share(of_opponent, against),
            test=test,
            beside=beside,
            people=len(_counts(of_opponent)),
            clusters=len(_units(of_opponent, against)),
            answers=len(of_opponent),
            look_alike=sum(comparison.look_alike for comparison in of_opponent),
            stand_ins=len({comparison.person for comparison in of_opponent if comparison.stand_in}),
            earlier=tuple({one.person: one.earlier for one in of_opponent if one.earlier is not None}.values()),
        )
        for (against, of_opponent), test, (_, beside) in zip(of_arm, tests, raw, strict=True)
    ]


def _tests(comparisons: Sequence[Comparison], against: str, plan: AnalysisPlan) -> tuple[Tested, Tested]:
    """The declared test, and the other one. Sign test: which of the two a unit chose more often. Signed ranks: by how
    much more of its people's choices than half."""
    names = ("the own policy", ARMS[against])
    about = f"own policy against {ARMS[against]}"
    shares = own_shares(comparisons, against)
    over, under = (shares > 0.5).astype(int), (shares < 0.5).astype(int)
    sign = sign_test(over.tolist(), under.tolist(), about=about, names=names)
    if len(shares) < 2:
        return sign, sign
    ranks = wilcoxon(shares, np.full(len(shares), 0.5), about=about, names=names)
    more, fewer = names if ranks.effect >= 0 else names[::-1]
    ranks = replace(ranks, direction=f"{more} is mostly chosen over {fewer}")
    return (sign, ranks) if plan.own == "sign" else (ranks, sign)


def own_against(comparisons: Sequence[Comparison], against: str) -> list[Comparison]:
    """Those of the own policy and that arm."""
    return [comparison for comparison in comparisons if {comparison.chosen, comparison.rejected} == {"own", against}]


def own_shares(comparisons: Sequence[Comparison], against: str) -> NDArray[np.float64]:
    """Of every independent unit the mean share of its people's choices that went to the own policy: (n,)."""
    units = _units(own_against(comparisons, against), against)
    return np.array([_mean_share(unit, against) for unit in units.values()])


def _units(comparisons: Sequence[Comparison], against: str) -> dict[str, list[Comparison]]:
    """Comparisons by what was sampled: people, or of lent policies all of the people who were lent one of them."""
    of_person: dict[str, list[Comparison]] = defaultdict(list)
    for comparison in comparisons:
        of_person[comparison.person].append(comparison)
    if against != "other":
        return of_person
    units: dict[str, list[Comparison]] = defaultdict(list)
    for person, mine in of_person.items():
        lent = sorted({comparison.opponent for comparison in mine if comparison.opponent})
        units[lent[0] if len(lent) == 1 else f"person {person}"] += mine
    return units


def _mean_share(comparisons: Sequence[Comparison], against: str) -> float:
    """Mean over the unit's people of the share of their choices that went to the own policy."""
    counts = _counts(comparisons)
    return float(np.mean([of["own"] / (of["own"] + of[against]) for of in counts.values()]))


def _counts(comparisons: Sequence[Comparison]) -> Mapping[str, Counter[str]]:
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for comparison in comparisons:
        counts[comparison.person][comparison.chosen] += 1
    return counts


def _share(comparisons: Sequence[Comparison], against: str) -> Mean:
    units = [_counts(unit) for unit in _units(comparisons, against).values()]
    if all(len(unit) == 1 for unit in units):
        people = [of for unit in units for of in unit.values()]
        return share_over_people([of["own"] for of in people], [of[against] for of in people])
    return share_over_people(  # people of one lent policy weigh as one
        [sum(of["own"] for of in unit.values()) for unit in units],
        [sum(of[against] for of in unit.values()) for unit in units],
    )


@dataclass(frozen=True)
class Guessed:
    """Who could tell which of the last pair came from their own answers: how many were right, against chance."""

    right: int
    people: int
    test: Tested


def count_guesses(guesses: Sequence[Guess]) -> Guessed | None:
    """The guesses of a study; None where nobody was asked."""
    if not guesses:
        return None
    right = sum(guess.right for guess in guesses)
    test = binomial_test(right, len(guesses), about="guess which of the last pair came from the own answers")
    return Guessed(right, len(guesses), test)
