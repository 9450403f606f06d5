"""How somebody clicked, whatever was shown: nearly always the same letter, or too fast to have compared anything.

Such answers say nothing of a taste, so nothing is learned from them (`alignment_jobs.py`); experimenters see a flag
(`web/lab/monitoring.py`). Pure, but for the answers of a session. All numbers are ours.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.models import Response, Session, Trial
from desirepath.store.sides import is_side, is_tie
from desirepath.store.who_counts import TEACHING_ROLES

ONE_SIDED_P = 0.01
ONE_SIDED_SHARE = 0.8
TOO_FAST_S = 0.5  # a choice between two seen trajectories in less was hardly a choice
FAST_SHARE = 0.5  # of the choices so fast ...
FAST_FROM = 5  # ... among so many


@dataclass(frozen=True)
class PositionBias:
    """Of choices whose sides were drawn by lot: the letter chosen most often, how often, of how many; p: two-sided
    exact binomial probability of so uneven a count where position does not matter."""

    letter: str
    times: int
    of: int
    p: float

    @property
    def is_found(self) -> bool:
        """Whether chance hardly gives so uneven a count; the fewest are 8 choices, all of them alike."""
        return self.p < ONE_SIDED_P and self.times >= ONE_SIDED_SHARE * self.of


def position_bias(choices: Sequence[str]) -> PositionBias:
    """choices: `a` or `b`, in any order; none is no bias."""
    letter, times = (Counter(choices).most_common(1) or [("a", 0)])[0]
    n = len(choices)
    so_many = sum(math.comb(n, k) for k in range(times, n + 1))
    return PositionBias(letter, times, n, min(1.0, 2 * so_many / 2**n))


NO_CHOICES = position_bias(())


def is_too_fast(decision_s: Sequence[float], at_least: int = FAST_FROM) -> bool:
    """Whether at least half of `at_least` choices or more took less than half a second each."""
    fast = sum(1 for seconds in decision_s if seconds < TOO_FAST_S)
    return len(decision_s) >= at_least and fast >= FAST_SHARE * len(decision_s)


def find_letters(s: DatabaseSession, session: Session) -> list[str]:
    """The letters of the session's choices that would teach."""
    return [letter for letter, _ in _choices(s, session) if letter is not None]


def without_comparing(s: DatabaseSession, session: Session) -> str | None:
    """Why nothing can be learned from the session's choices: `one_sided`, `too_fast`, or None. Simulated participants
    decide in no time."""
    choices = _choices(s, session)
    if position_bias([letter for letter, _ in choices if letter is not None]).is_found:
        return "one_sided"
    seconds = [took for _, took in choices if took is not None]
    return "too_fast" if not session.simulated and is_too_fast(seconds) else None


def _choices(s: DatabaseSession, session: Session) -> list[tuple[str | None, float | None]]:
    """Letter and seconds of each; no letter: no difference."""
    rows = s.execute(
        select(Response.value, Response.decision_s)
        .join(Trial, Response.trial_id == Trial.id)
        .where(Trial.session_id == session.id, Trial.kind == "query", Trial.role.in_(TEACHING_ROLES))
    )
    return [(value.get("choice"), took) for value, took in rows if is_side(value.get("choice")) or is_tie(value)]
