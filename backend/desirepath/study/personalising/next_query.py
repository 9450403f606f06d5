"""Which query a trial asks about: the planned one, or the one that teaches most after the answers so far.

What answers say is `learning.preferences.posterior`'s, what teaches most `learning.queries.choosing`'s; here both meet
the stored rows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.artefacts import ArtefactStore, load_artefact
from desirepath.store.database import Database
from desirepath.store.models import ProtocolVersion, Response, Session, Study, Trial
from desirepath.store.query_sets import StoredQuery, queries_of
from desirepath.store.sides import shown_on
from desirepath.store.who_counts import TEACHING_ROLES
from desirepath.study.protocol_rows import newest_number, protocol_row, row_of

if TYPE_CHECKING:
    from desirepath.study.kinds.base import Acting
    from desirepath.study.kinds.trial import TrialStep

if TYPE_CHECKING:  # numba and the simulator come with these; a server that never chooses need not load them
    from desirepath.learning.measures.pairs import PairDifferences
    from desirepath.learning.preferences.free_posterior import FreePosterior
    from desirepath.learning.preferences.posterior import Posterior

Doubles = NDArray[np.float64]
Answers = tuple[tuple[str, str], ...]
BEYOND = "information_beyond"
KEPT_POSTERIORS = 64  # ours: about 1 MB each; a session needs its newest one


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
    """A query set with what its trajectories measure: differences (n, spans, 7) of first minus second, in its order.

    symmetry: the protocol's.
    """

    setup: str
    symmetry: str
    queries: tuple[StoredQuery, ...]
    differences: Doubles

    def index(self) -> dict[str, int]:
        """Where each query stands, by id."""
        return {query.id: i for i, query in enumerate(self.queries)}


def asked_in(acting: Acting, step: TrialStep) -> Asked:
    """What the trial of that step shows."""
    s, session = acting.s, acting.session
    if step.again is not None:
        return _asked_again(s, session, step)
    if step.query is not None:
        return Asked(step.query, str(step.trajectory_a), str(step.trajectory_b), step.sides_swapped)
    from desirepath.learning.queries.choosing import NextQuery, next_query

    measured = measured_queries(s, acting.files, row_of(s, session))
    used = set(s.scalars(select(Trial.query_id).where(Trial.session_id == session.id)))
    used |= {query for one in acting.plan if (query := getattr(one, "query", None)) is not None}
    left = [i for i, query in enumerate(measured.queries) if query.id not in used]
    answers = answers_of(s, session)
    random = np.random.default_rng([session.seed, 31, session.position])
    how = step.choose or "random"
    if how == BEYOND:
        differences = pair_differences(s, acting.files, row_of(s, session))
        beyond = beyond_after(s, acting.files, row_of(s, session), answers)
        best = int(beyond.bits_about(differences[left], differences.thinned()).argmax())
        chosen = NextQuery(best, float(beyond.information_bits(differences[[left[best]]])[0]))
    else:
        chosen = next_query(posterior_after(measured, answers), measured.differences[left], how, random)
    query = measured.queries[left[chosen.index]]
    sides = (query.trajectory_a, query.trajectory_b)
    a, b = sides[::-1] if step.sides_swapped else sides
    why = {"by": how, "bits": round(chosen.bits, 4), "answers": len(answers), "of": len(left)}
    return Asked(query.id, a, b, step.sides_swapped, why=why)


def _asked_again(s: DatabaseSession, session: Session, step: TrialStep) -> Asked:
    before = s.scalars(select(Trial).where(Trial.session_id == session.id, Trial.step_key == step.again)).one()
    sides = (before.trajectory_a, before.trajectory_b)
    a, b = sides[::-1] if step.role == "swap" else sides
    return Asked(str(before.query_id), a, b, step.sides_swapped, probe_of=before.id)


def little_left(acting: Acting, step: TrialStep) -> bool:
    """Does the protocol's stopping rule end the chosen queries here?"""
    if step.stop is None:
        return False
    from desirepath.learning.queries.choosing import StoppingRule, best_information

    rule = StoppingRule(**step.stop.model_dump())
    answers = answers_of(acting.s, acting.session)
    measured = measured_queries(acting.s, acting.files, row_of(acting.s, acting.session))
    promised = [np.inf] * len(answers)  # only the last ones count
    row = row_of(acting.s, acting.session)
    for after in range(max(1, len(answers) - rule.in_a_row + 1), len(answers) + 1):
        used = {query for query, _ in answers[:after]}
        left = [i for i, query in enumerate(measured.queries) if query.id not in used]
        if step.choose == BEYOND:
            differences = pair_differences(acting.s, acting.files, row)[left]
            beyond = beyond_after(acting.s, acting.files, row, answers[:after])
            promised[after - 1] = float(beyond.information_bits(differences).max())
        else:
            posterior = posterior_after(measured, answers[:after])
            promised[after - 1] = best_information(posterior, measured.differences[left])
        if promised[after - 1] >= rule.below_bits:
            return False
    return rule.met(promised)


def posterior_of(s: DatabaseSession, files: ArtefactStore, session: Session) -> Posterior:
    """What the session's answers so far say, without practice and probes."""
    return posterior_after(measured_queries(s, files, row_of(s, session)), answers_of(s, session))


def answers_of(s: DatabaseSession, session: Session) -> Answers:
    """(query, id of the trajectory that was chosen) of regular and further trials, in the order they were asked."""
    rows = s.execute(
        select(Trial, Response)
        .join(Response, Response.trial_id == Trial.id)
        .where(Trial.session_id == session.id, Trial.kind == "query", Trial.role.in_(TEACHING_ROLES))
        .order_by(Trial.index)
    )
    return tuple(
        (str(trial.query_id), shown_on(response.value["choice"], trial.trajectory_a, trial.trajectory_b))
        for trial, response in rows
        if "choice" in response.value  # not where the time for it was over
    )


def posterior_after(measured: MeasuredQueries, answers: Answers) -> Posterior:
    """The posterior after those answers; goes on from the longest beginning of them that is remembered."""
    from desirepath.learning.preferences.posterior import Posterior, PosteriorConfig

    def key(n: int) -> tuple[str, str, Answers]:
        return measured.setup, measured.symmetry, answers[:n]  # queries are named by their content

    known = next((n for n in range(len(answers), 0, -1) if key(n) in _posteriors), 0)
    if known:
        posterior = _posteriors[key(known)]
    else:
        config = PosteriorConfig(left_right_symmetry=measured.symmetry == "left_right")
        posterior = Posterior.prior(measured.setup, config)
    places = measured.index()
    for n in range(known, len(answers)):
        query, chosen = answers[n]
        row = places[query]
        posterior = posterior.updated(measured.differences[row], chosen == measured.queries[row].trajectory_a)
    _posteriors[key(len(answers))] = posterior
    while len(_posteriors) > KEPT_POSTERIORS:
        _posteriors.pop(next(iter(_posteriors)), None)
    return posterior


_posteriors: dict[tuple[str, str, Answers], Posterior] = {}


def beyond_after(
    s: DatabaseSession, files: ArtefactStore, study: Study | ProtocolVersion, answers: Answers
) -> FreePosterior:
    """The posterior beyond the nine objectives after those answers; goes on from what is remembered, as above."""
    from desirepath.learning.preferences.free_posterior import FreeConfig, FreePosterior
    from desirepath.learning.preferences.posterior import PosteriorConfig

    measured, differences = measured_queries(s, files, study), pair_differences(s, files, study)

    def key(n: int) -> tuple[str, str, Answers]:
        return measured.setup, measured.symmetry, answers[:n]

    known = next((n for n in range(len(answers), 0, -1) if key(n) in _beyond), 0)
    if known:
        posterior = _beyond[key(known)]
    else:
        config = PosteriorConfig(left_right_symmetry=measured.symmetry == "left_right")
        posterior = FreePosterior.prior(measured.setup, FreeConfig(posterior=config))
    places = measured.index()
    for n in range(known, len(answers)):
        query, chosen = answers[n]
        row = places[query]
        posterior = posterior.updated(differences[[row]], chosen == measured.queries[row].trajectory_a)
    _beyond[key(len(answers))] = posterior
    while len(_beyond) > KEPT_POSTERIORS:
        _beyond.pop(next(iter(_beyond)), None)
    return posterior


_beyond: dict[tuple[str, str, Answers], FreePosterior] = {}


def pair_differences(s: DatabaseSession, files: ArtefactStore, study: Study | ProtocolVersion) -> PairDifferences:
    """How the pairs of a study's query set differ by everything that may be preferred, once per process."""
    set_id, symmetry = study.protocol["materials"]["query_set"], study.protocol.get("symmetry", "none")
    known = _pairs.get((set_id, symmetry))
    if known is None:
        from desirepath.learning.measures.pairs import PairDifferences
        from desirepath.learning.queries.queries import QuerySet

        artefact, content = load_artefact(s, files, set_id, kind="query_set")
        pairs = [(query.trajectory_a, query.trajectory_b) for query in QuerySet.from_bytes(content).queries]
        known = PairDifferences.of(artefact.setup, pairs, left_right_symmetry=symmetry == "left_right")
        _pairs[set_id, symmetry] = known
    return known


_pairs: dict[tuple[str, str], PairDifferences] = {}  # by content hash; 1 MB for 200 queries


def measured_queries(s: DatabaseSession, files: ArtefactStore, study: Study | ProtocolVersion) -> MeasuredQueries:
    """The query set of a study's protocol, measured once per process."""
    set_id, symmetry = study.protocol["materials"]["query_set"], study.protocol.get("symmetry", "none")
    known = _measured.get((set_id, symmetry))
    if known is None:
        from desirepath.learning.preferences.spans import seen_in
        from desirepath.learning.queries.queries import QuerySet

        artefact, content = load_artefact(s, files, set_id, kind="query_set")
        queries = QuerySet.from_bytes(content).queries
        stored = tuple(queries_of(s, files, set_id))
        known = MeasuredQueries(artefact.setup, symmetry, stored, seen_in(queries))
        _measured[set_id, symmetry] = known
    return known


def prepare(database: Database, files: ArtefactStore) -> None:
    """Measure the query sets of the open studies that choose, before the first participant has to wait for it."""
    with database.session() as s:
        for study in s.scalars(select(Study).where(Study.state == "open")):
            row = protocol_row(s, study, newest_number(s, study))
            how = set(_chosen_by(row))
            if how - {"random"}:
                measured_queries(s, files, row)
            if BEYOND in how:
                pair_differences(s, files, row)


def _chosen_by(row: Study | ProtocolVersion) -> Iterator[str]:
    """How the protocol chooses what it asks in its blocks and after them, as it is stored."""
    for entry in row.protocol["stages"]:
        for one in (entry.get("block") or {}).get("trials", []):
            yield one["queries"].get("choose", "random")
        if "choices" in (entry.get("methods") or {}).get("methods", ()):
            yield "information"  # whatever chooses them: what they taught is asked for while somebody waits
        further = (entry.get("train") or {}).get("ask_on")
        if further:
            yield further["choose"]


_measured: dict[tuple[str, str], MeasuredQueries] = {}  # by content hash, so never stale; 11 kB for 200 queries
