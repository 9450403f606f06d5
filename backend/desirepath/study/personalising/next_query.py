"""Which query a trial asks about: the planned one, or the one that teaches most after the answers so far.

What answers say is `learning.preferences.posterior`'s, what teaches most `learning.queries.choosing`'s; here both meet
the stored rows.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Union, cast

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.learning.queries.choosing import STRATEGIES, Candidates, QueryStrategy, StoppingRule
from desirepath.store.artefacts import ArtefactStore, load_artefact, load_trajectory
from desirepath.store.database import Database
from desirepath.store.marks import Mark, marks_in
from desirepath.store.models import ProtocolVersion, Response, Session, StrokeRow, Study, Trial
from desirepath.store.query_sets import StoredQuery, queries_of
from desirepath.store.sides import is_answer_to_several, shown_on
from desirepath.store.who_counts import TEACHING_ROLES
from desirepath.study.protocol_rows import newest_number, protocol_row, row_of

if TYPE_CHECKING:
    from desirepath.study.kind import Acting

if TYPE_CHECKING:  # numba and the simulator come with these; a server that never chooses need not load them
    from desirepath.learning.measures.pairs import PairDifferences
    from desirepath.learning.preferences.evidence.demonstrated import Demonstrated
    from desirepath.learning.preferences.evidence.graded_pair import Degree, Possible
    from desirepath.learning.preferences.evidence.marked_moment import MarkedMoment
    from desirepath.learning.preferences.evidence.ranking import Ranking
    from desirepath.learning.preferences.evidence.rating import Rating
    from desirepath.learning.preferences.free_posterior import FreePosterior
    from desirepath.learning.preferences.posterior import Posterior
    from desirepath.simulation.trajectory import Trajectory

Doubles = NDArray[np.float64]
AnyGiven = Union["Given", "GivenRating", "GivenOrder", "GivenMarks", "GivenPath"]
Answers = tuple[AnyGiven, ...]
KEPT_POSTERIORS = 64  # ours: about 1 MB each; a session needs its newest one


class Given(NamedTuple):
    """An answer to a pair. chosen: the trajectory's id, None where there is no difference. degree, possible: how clear
    it was, among how many answers (`evidence/graded_pair.py`)."""

    query: str
    chosen: str | None
    degree: str | None = None
    possible: int = 2


class GivenRating(NamedTuple):
    """A rating that counts at once. before: what was rated before it under the same condition, by id."""

    query: str
    trajectory: str
    rating: int
    points: int
    before: tuple[str, ...]

    @property
    def chosen(self) -> None:
        """It is no choice of two."""


class GivenOrder(NamedTuple):
    """Several of one scene, by id: put in order, the best first, of which `said` places were said (the others follow in
    any order); or, piles > 0, each with its pile, from 1 for the least liked."""

    query: str
    order: tuple[str, ...]
    said: int
    in_pile: tuple[int, ...] = ()
    piles: int = 0

    @property
    def chosen(self) -> None:
        """It is no choice of two."""

    @classmethod
    def of(cls, query: str, shown: Sequence[str], value: Mapping[str, Any]) -> GivenOrder:
        """shown: by number; value: as it is stored."""
        if (groups := value.get("groups")) is not None:
            pile = {number: k for k, numbers in enumerate(groups, 1) for number in numbers}
            return cls(query, tuple(shown), 0, tuple(pile[n + 1] for n in range(len(shown))), len(groups))
        first = [shown[number - 1] for number in value["order"]]
        return cls(query, (*first, *(one for one in shown if one not in first)), len(first))

    def evidence(self, measured: Doubles) -> Iterator[Ranking | Rating]:
        """What it says. measured (k, spans, 7), of `order`. A pile is a rating beside all others'."""
        from desirepath.learning.preferences.evidence.ranking import Ranking
        from desirepath.learning.preferences.evidence.rating import Rating

        if not self.piles:
            yield Ranking(measured, self.said)
        for k, pile in enumerate(self.in_pile):
            yield Rating(np.roll(measured, -1 - k, axis=0), pile, self.piles)  # itself last


class GivenMarks(NamedTuple):
    """Moments of a trajectory that were marked, seconds to the tap: bad ones, and good ones."""

    query: str
    trajectory: str
    bad_s: tuple[float, ...]
    good_s: tuple[float, ...]

    @property
    def chosen(self) -> None:
        """It is no choice of two."""

    @classmethod
    def of(cls, query: str, trajectory: str, marks: Sequence[Mark]) -> GivenMarks:
        bad, good = (tuple(mark.at_s for mark in marks if mark.better is better) for better in (False, True))
        return cls(query, trajectory, bad, good)

    def evidence(self, trajectory: Trajectory) -> Iterator[MarkedMoment]:
        """What each of them says beside the parts of the trajectory that were not marked so."""
        from desirepath.learning.preferences.evidence.marked_moment import MarkedMoment
        from desirepath.learning.preferences.spans import marked_parts, part_measures

        for better, taps_s in ((False, self.bad_s), (True, self.good_s)):
            marked, others = marked_parts(trajectory, taps_s)
            if not (marked and others):
                continue
            seen = part_measures([*marked, *others])
            for k in range(len(marked)):
                yield MarkedMoment(seen[[k, *range(len(marked), len(seen))]], better)


class GivenPath(NamedTuple):
    """A path that counts at once. pair: in which of the environment's scenes it was drawn; trajectory: what the robot
    made of it."""

    environment: str
    pair: int
    trajectory: str

    @property
    def query(self) -> None:
        """It is about no query."""

    @property
    def chosen(self) -> None:
        """It is no choice of two."""

    def evidence(self, trajectory: Trajectory) -> Demonstrated:
        """What it says beside what the conditioned policy does there, all judged as wholes."""
        from desirepath.learning.preferences.evidence.demonstrated import Demonstrated
        from desirepath.learning.preferences.from_paths import shipped_weights_of_paths
        from desirepath.learning.preferences.measures import measures
        from desirepath.learning.preferences.spans import SPANS_S

        others = shipped_weights_of_paths(self.environment).alternatives(self.pair)
        whole = np.concatenate([measures([trajectory]), others])
        return Demonstrated(np.repeat(whole[:, None], len(SPANS_S), axis=1))


@dataclass(frozen=True)
class Asked:
    """What a trial shows. sides_swapped: the query's second trajectory is A. `probe_of`: the trial that is asked again.
    `why`: for the event log, None where the plan knew the query before.
    """

    query: str
    trajectory_a: str
    trajectory_b: str
    sides_swapped: bool
    probe_of: str | None = None
    why: dict[str, Any] | None = None


@dataclass(frozen=True)
class MeasuredQueries:
    """A query set with what its trajectories measure: measured (n, 2, spans, 7) of first and second, in its order;
    differences (n, spans, 7) of first minus second. symmetry: the protocol's.
    """

    setup: str
    symmetry: str
    queries: tuple[StoredQuery, ...]
    measured: Doubles
    files: ArtefactStore = field(repr=False)

    @cached_property
    def differences(self) -> Doubles:
        difference: Doubles = self.measured[:, 0] - self.measured[:, 1]
        return difference

    @cached_property
    def of_trajectory(self) -> dict[str, Doubles]:
        """(spans, 7) by id."""
        names = [one for query in self.queries for one in (query.trajectory_a, query.trajectory_b)]
        return dict(zip(names, self.measured.reshape(-1, *self.measured.shape[2:]), strict=True))

    def of_all(self, trajectories: Sequence[str]) -> Doubles:
        """(k, spans, 7) of these, by id, also of such as are shown beside the set's."""
        if unknown := [one for one in dict.fromkeys(trajectories) if one not in self.of_trajectory]:
            from desirepath.learning.preferences.spans import seen_measures

            seen = seen_measures([load_trajectory(self.files, one) for one in unknown])
            self.of_trajectory.update(zip(unknown, seen, strict=True))
        return np.stack([self.of_trajectory[one] for one in trajectories])

    def index(self) -> dict[str, int]:
        """Where each query stands, by id."""
        return {query.id: i for i, query in enumerate(self.queries)}


class Remembered:
    """What was computed from the files of one store, in this process: query sets, and posteriors after answers.

    Sets are known by content hash, so never stale: 11 kB for 200 queries, 1 MB with all that may be preferred.
    """

    def __init__(self) -> None:
        self._measured: dict[tuple[str, str], MeasuredQueries] = {}
        self._pairs: dict[tuple[str, str], PairDifferences] = {}
        self._posteriors: dict[tuple[bool, str, str, Answers], Any] = {}

    def measure_queries(
        self, s: DatabaseSession, files: ArtefactStore, study: Study | ProtocolVersion
    ) -> MeasuredQueries:
        """The query set of a study's protocol."""
        key = set_id, symmetry = _query_set(study)
        if key not in self._measured:
            from desirepath.learning.preferences.spans import seen_measures
            from desirepath.learning.queries.queries import QuerySet

            artefact, content = load_artefact(s, files, set_id, kind="query_set")
            queries = QuerySet.from_bytes(content).queries
            stored = tuple(queries_of(s, files, set_id))
            seen = seen_measures([of for query in queries for of in (query.trajectory_a, query.trajectory_b)])
            measured = seen.reshape(len(queries), 2, *seen.shape[1:])
            self._measured[key] = MeasuredQueries(artefact.setup, symmetry, stored, measured, files)
        return self._measured[key]

    def pairs(self, s: DatabaseSession, files: ArtefactStore, study: Study | ProtocolVersion) -> PairDifferences:
        """How its pairs differ by everything that may be preferred."""
        key = set_id, symmetry = _query_set(study)
        if key not in self._pairs:
            from desirepath.learning.measures.pairs import PairDifferences
            from desirepath.learning.queries.queries import QuerySet

            artefact, content = load_artefact(s, files, set_id, kind="query_set")
            pairs = [(query.trajectory_a, query.trajectory_b) for query in QuerySet.from_bytes(content).queries]
            self._pairs[key] = PairDifferences.of(artefact.setup, pairs, left_right_symmetry=symmetry == "left_right")
        return self._pairs[key]

    def posterior(self, measured: MeasuredQueries, answers: Answers) -> Posterior:
        """What those answers say of the weights of the objectives."""
        from desirepath.learning.preferences.evidence.graded_pair import GradedPair
        from desirepath.learning.preferences.evidence.rating import Rating
        from desirepath.learning.preferences.posterior import Posterior, PosteriorConfig

        config = PosteriorConfig(left_right_symmetry=measured.symmetry == "left_right")
        places = measured.index()

        def believe(posterior: Posterior, given: AnyGiven) -> Posterior:
            if isinstance(given, GivenPath):
                return posterior.observed(given.evidence(load_trajectory(measured.files, given.trajectory)))
            if isinstance(given, GivenMarks):
                trajectory = load_trajectory(measured.files, given.trajectory)
                return reduce(Posterior.observed, given.evidence(trajectory), posterior)
            if isinstance(given, GivenOrder):
                return reduce(Posterior.observed, given.evidence(measured.of_all(given.order)), posterior)
            if isinstance(given, GivenRating):
                rated = measured.of_all((*given.before, given.trajectory))
                return posterior.observed(Rating(rated, given.rating, given.points))
            row = places[given.query]
            first = given.chosen == measured.queries[row].trajectory_a
            if given.possible == 2:
                return posterior.updated(measured.differences[row], first)
            better: Literal[-1, 0, 1] = 0 if given.chosen is None else 1 if first else -1
            degree, possible = cast("Degree | None", given.degree), cast("Possible", given.possible)
            return posterior.observed(GradedPair(measured.measured[row], better, degree, possible))

        own: Posterior = self._after(measured, answers, believe, lambda: Posterior.prior(measured.setup, config))
        return own

    def beyond(self, measured: MeasuredQueries, pairs: PairDifferences, answers: Answers) -> FreePosterior:
        """What they say of whatever they may be about: the choices among them alone."""
        from desirepath.learning.preferences.free_posterior import FreeConfig, FreePosterior
        from desirepath.learning.preferences.posterior import PosteriorConfig

        config = FreeConfig(posterior=PosteriorConfig(left_right_symmetry=measured.symmetry == "left_right"))
        places = measured.index()

        def believe(before: FreePosterior, given: Given) -> FreePosterior:
            row = places[given.query]
            return before.updated(pairs[[row]], given.chosen == measured.queries[row].trajectory_a)

        posterior: FreePosterior = self._after(
            measured,
            tuple(given for given in answers if given.chosen is not None),
            believe,
            lambda: FreePosterior.prior(measured.setup, config),
            beyond=True,
        )
        return posterior

    def _after(
        self,
        measured: MeasuredQueries,
        answers: Answers,
        believe: Callable[[Any, Any], Any],
        prior: Callable[[], Any],
        *,
        beyond: bool = False,
    ) -> Any:
        """The posterior after those answers; goes on from the longest beginning of them that is remembered.

        believe: the next one, of the one before and an answer.
        """

        def key(n: int) -> tuple[bool, str, str, Answers]:
            return beyond, measured.setup, measured.symmetry, answers[:n]  # queries are named by their content

        known = next((n for n in range(len(answers), 0, -1) if key(n) in self._posteriors), 0)
        posterior = self._posteriors[key(known)] if known else prior()
        for given in answers[known:]:
            posterior = believe(posterior, given)
        self._posteriors[key(len(answers))] = posterior
        while len(self._posteriors) > KEPT_POSTERIORS:
            self._posteriors.pop(next(iter(self._posteriors)), None)
        return posterior


def recall(files: ArtefactStore) -> Remembered:
    """What this process remembers of that store."""
    return files.derive(Remembered)


def _query_set(study: Study | ProtocolVersion) -> tuple[str, str]:
    return study.protocol["materials"]["query_set"], study.protocol.get("symmetry", "none")


def _situation(
    acting: Acting, strategy: QueryStrategy[Any, Any], answers: Answers, used: Container[str | None]
) -> tuple[MeasuredQueries, Any, Candidates[Any]]:
    """What a strategy of choosing goes by: the posterior after those answers, and what was not used yet."""
    memory, row = recall(acting.files), row_of(acting.s, acting.session)
    measured = memory.measure_queries(acting.s, acting.files, row)
    left = [i for i, query in enumerate(measured.queries) if query.id not in used]
    if not strategy.beyond:
        return measured, memory.posterior(measured, answers), Candidates(measured.differences, left)
    pairs = memory.pairs(acting.s, acting.files, row)
    return measured, memory.beyond(measured, pairs, answers), Candidates(pairs, left)


def choose_query(acting: Acting, how: str, *, sides_swapped: bool) -> Asked:
    """The query that teaches most now by that strategy."""
    s, session = acting.s, acting.session
    used = set(s.scalars(select(Trial.query_id).where(Trial.session_id == session.id)))
    used |= {query for step in acting.plan if (query := getattr(step, "query", None)) is not None}
    answers = answers_of(s, session)
    random = np.random.default_rng([session.seed, 31, session.position])
    measured, posterior, candidates = _situation(acting, STRATEGIES[how], answers, used)
    chosen = STRATEGIES[how].ask_next(posterior, candidates, random)
    query = measured.queries[candidates.left[chosen.index]]
    sides = (query.trajectory_a, query.trajectory_b)
    a, b = sides[::-1] if sides_swapped else sides
    why = {"by": how, "bits": round(chosen.bits, 4), "answers": len(answers), "of": len(candidates.left)}
    return Asked(query.id, a, b, sides_swapped, why=why)


def little_left(acting: Acting, how: str, rule: StoppingRule) -> bool:
    """Does the protocol's stopping rule end the queries here that are chosen by that strategy?"""
    strategy = STRATEGIES[how]
    answers = answers_of(acting.s, acting.session)
    promised = [np.inf] * len(answers)  # only the last ones count
    for after in range(max(1, len(answers) - rule.in_a_row + 1), len(answers) + 1):
        used = {given.query for given in answers[:after]}
        _, posterior, candidates = _situation(acting, strategy, answers[:after], used)
        promised[after - 1] = strategy.best_bits(posterior, candidates)
        if promised[after - 1] >= rule.below_bits:
            return False
    return rule.met(promised)


def posterior_of(s: DatabaseSession, files: ArtefactStore, session: Session) -> Posterior:
    """What the session's answers so far say, without practice and probes."""
    memory = recall(files)
    return memory.posterior(memory.measure_queries(s, files, row_of(s, session)), answers_of(s, session))


def answers_of(s: DatabaseSession, session: Session) -> Answers:
    """Of regular and further trials, orders, marks, and ratings and paths that count at once, as they were asked."""
    rows = s.execute(
        select(Trial, Response.value)
        .join(Response, Response.trial_id == Trial.id)
        .where(
            Trial.session_id == session.id,
            Trial.kind.in_(("query", "rating", "order", "mark")),
            Trial.role.in_(TEACHING_ROLES),
        )
        .order_by(Trial.index)
    )
    rated_at_once = [step for step in session.plan if step["kind"] == "rating" and step.get("at_once")]
    points = {step["key"]: step["points"] for step in rated_at_once}
    before: dict[str | None, list[str]] = {}
    answers: list[AnyGiven] = []
    paths = _paths_at_once(s, session)
    for trial, said in rows:
        while paths and paths[0][0] < trial.index:
            answers.append(paths.pop(0)[1])
        if said.get("timed_out"):
            continue
        if trial.kind == "query":
            chosen = shown_on(said["choice"], trial.trajectory_a, trial.trajectory_b) if "choice" in said else None
            answers.append(Given(str(trial.query_id), chosen, said.get("degree"), said.get("possible", 2)))
        elif trial.kind == "order" and is_answer_to_several(said, len(trial.shown)):
            answers.append(GivenOrder.of(str(trial.query_id), trial.shown, said))
        elif trial.kind == "mark":
            if marks := marks_in(said):
                answers.append(GivenMarks.of(str(trial.query_id), trial.trajectory_a, marks))
        elif trial.step_key in points:
            rated = before.setdefault(trial.block, [])
            told = (str(trial.query_id), trial.trajectory_a, said["rating"], points[trial.step_key])
            answers.append(GivenRating(*told, tuple(rated)))
            rated.append(trial.trajectory_a)
    return (*answers, *(path for _, path in paths))


def _paths_at_once(s: DatabaseSession, session: Session) -> list[tuple[int, GivenPath]]:
    """(place in the plan, what was kept there) of steps at which a path counts at once, in their order."""
    places = {
        step["key"]: place
        for place, step in enumerate(session.plan)
        if step["kind"] == "demonstration" and step.get("at_once")
    }
    if not places:
        return []
    kept = select(StrokeRow).where(
        StrokeRow.session_id == session.id,
        StrokeRow.step_key.in_(places),
        StrokeRow.state == "kept",
        StrokeRow.left_out_at.is_(None),
        StrokeRow.trajectory.is_not(None),
    )
    drawn = [
        (places[stroke.step_key], GivenPath(stroke.environment, stroke.pair, str(stroke.trajectory)))
        for stroke in s.scalars(kept)
    ]
    return sorted(drawn)


def prepare(database: Database, files: ArtefactStore) -> None:
    """Measure the query sets of the open studies that choose, before the first participant has to wait for it."""
    with database.session() as s:
        for study in s.scalars(select(Study).where(Study.state == "open")):
            row = protocol_row(s, study, newest_number(s, study))
            if not (how := set(_strategies_in(row)) - {"random"}):
                continue
            recall(files).measure_queries(s, files, row)
            if any(STRATEGIES[name].beyond for name in how):
                recall(files).pairs(s, files, row)


def _strategies_in(row: Study | ProtocolVersion) -> Iterator[str]:
    """How the protocol chooses what it asks in its blocks and after them, as it is stored."""
    for entry in row.protocol["stages"]:
        for trials in (entry.get("block") or {}).get("trials", []):
            yield trials["queries"].get("choose", "random")
        if "choices" in (entry.get("methods") or {}).get("methods", ()):
            yield "information"  # whatever chooses them: what they taught is asked for while somebody waits
        further = (entry.get("train") or {}).get("ask_on")
        if further:
            yield further["choose"]
