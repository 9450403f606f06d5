"""What the page of a study's drawn paths shows: kept paths with their quality, learned controllers with their
trajectories.

People and simulated participants are never mixed. Renders and changes nothing; routes live in `demonstration_pages.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from sqlalchemy import Select, func, select, tuple_
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.simulation.trajectory import Trajectory
from desirepath.store.artefacts import ArtefactStore, load_trajectory
from desirepath.store.demonstration_snapshots import KEPT, read_demonstrations
from desirepath.store.job_results import DemonstrationsResult
from desirepath.store.models import Artefact, Job, Participant, Session, StrokeRow, Study
from desirepath.store.who_counts import not_withdrawn, participants_condition, reason_not_to_learn
from desirepath.study.personalising.alignment_jobs import PATHS_JOB

if TYPE_CHECKING:  # the simulator comes with these; a server that starts need not wait for it
    from desirepath.demonstrations.demonstration import Demonstration
    from desirepath.demonstrations.demonstration_quality import DemonstrationQuality

Who = Literal["people", "simulated"]
Placed = tuple[str, int]
"""Environment and number of a situation."""


@dataclass(frozen=True)
class KeptPath:
    """One kept path."""

    stroke: StrokeRow
    person: Participant
    demonstration: Demonstration
    quality: DemonstrationQuality

    @property
    def counts(self) -> bool:
        """Whether it is learned from."""
        return self.stroke.left_out_at is None and reason_not_to_learn(self.person, "all") is None

    @property
    def place(self) -> Placed:
        return self.stroke.environment, self.stroke.pair


@dataclass(frozen=True)
class Controller:
    """A training from this study's paths, whatever became of it. people: codes; paths: how many it learned from."""

    job: Job
    environment: str
    people: tuple[str, ...]
    paths: int

    @property
    def judged(self) -> Mapping[str, float | None]:
        """Its trajectories from the demonstrated starts against the demonstrations; nothing before it has succeeded."""
        result = self.job.result_as(DemonstrationsResult)
        return result.judged if result is not None else {}

    def trajectories(self, files: ArtefactStore) -> dict[int, dict[str, Trajectory]]:
        """Number of the situation -> demonstration (sha256) from whose start it rolls out -> trajectory."""
        found: dict[int, dict[str, Trajectory]] = {}
        result = self.job.result_as(DemonstrationsResult)
        for one in result.rollouts if result is not None else ():
            found.setdefault(one.pair, {})[one.demonstration] = load_trajectory(files, one.trajectory)
        return found


def places_of(s: DatabaseSession, study: Study, who: Who, person: Participant | None) -> dict[Placed, int]:
    """Place -> how many kept paths of those who did not withdraw, of everybody or of one person; in order."""
    counted = _kept(select(StrokeRow.environment, StrokeRow.pair, func.count()), study, who, person)
    counted = counted.group_by(StrokeRow.environment, StrokeRow.pair).order_by(StrokeRow.environment, StrokeRow.pair)
    return {(environment, pair): count for environment, pair, count in s.execute(counted)}


def find_drawn_paths(
    s: DatabaseSession,
    files: ArtefactStore,
    study: Study,
    who: Who,
    person: Participant | None,
    places: Iterable[Placed],
) -> list[KeptPath]:
    """The kept paths that `places_of` counts in some of the places, in their order; flags compare within one
    participant and place. About 5 ms each.
    """
    from desirepath.demonstrations.demonstration import Demonstration
    from desirepath.demonstrations.demonstration_quality import qualities

    asked = _kept(select(StrokeRow, Participant), study, who, person)
    asked = asked.where(tuple_(StrokeRow.environment, StrokeRow.pair).in_(list(places)))
    asked = asked.order_by(StrokeRow.environment, StrokeRow.pair, Participant.code, StrokeRow.created_at)
    rows = [(stroke, whose) for stroke, whose in s.execute(asked)]
    made = [Demonstration.from_bytes(files.get(stroke.demonstration or "")) for stroke, _ in rows]
    groups = [(whose.id, stroke.environment, stroke.pair) for stroke, whose in rows]
    return [
        KeptPath(stroke, whose, demonstration, quality)
        for (stroke, whose), demonstration, quality in zip(rows, made, qualities(made, groups), strict=True)
    ]


def _kept(
    asked: Select[*tuple[Any, ...]], study: Study, who: Who, person: Participant | None
) -> Select[*tuple[Any, ...]]:
    """The same about kept paths of those who did not withdraw, of everybody or of one person."""
    found = (
        asked.select_from(StrokeRow)
        .join(Session, Session.id == StrokeRow.session_id)
        .join(Participant, Participant.id == Session.participant_id)
        .where(
            Session.study_id == study.id,
            StrokeRow.state == KEPT,
            not_withdrawn(),
            participants_condition(who),
        )
    )
    return found if person is None else found.where(Participant.id == person.id)


def controllers_of(s: DatabaseSession, files: ArtefactStore, study: Study, who: Who) -> list[Controller]:
    """Every training from the study's paths whose demonstrations may still be used, the newest first."""
    asked = select(Job).where(Job.study_id == study.id, Job.kind == PATHS_JOB).order_by(Job.created_at.desc(), Job.id)
    found = []
    for job in s.scalars(asked):
        snapshot = s.get(Artefact, job.params["snapshot"])
        if snapshot is None or snapshot.quarantined_at is not None or snapshot.simulated != (who == "simulated"):
            continue
        environment, kept = read_demonstrations(files.get(snapshot.id))
        people = tuple(sorted({stroke.participant for stroke in kept}))
        found.append(Controller(job, environment, people, len(kept)))
    return found


def newest_of(controllers: Sequence[Controller], person: Participant | None) -> dict[str, Controller]:
    """Environment -> the newest controller that was learned from one person's paths, or from several people's."""
    found: dict[str, Controller] = {}
    for controller in controllers:
        fits = controller.people == (person.code,) if person is not None else len(controller.people) > 1
        if fits and controller.job.state == "succeeded":
            found.setdefault(controller.environment, controller)
    return found


def attempts_of(s: DatabaseSession, study: Study, who: Who) -> list[dict[str, Any]]:
    """Per participant how many strokes were kept, taken back, refused."""
    asked = (
        select(Participant.code, StrokeRow.state)
        .join(Session, Session.participant_id == Participant.id)
        .join(StrokeRow, StrokeRow.session_id == Session.id)
        .where(
            Participant.study_id == study.id,
            not_withdrawn(),
            participants_condition(who),
        )
        .order_by(Participant.code)
    )
    people: dict[str, dict[str, Any]] = {}
    for code, state in s.execute(asked):
        row = people.setdefault(code, {"code": code, KEPT: 0, "redone": 0, "refused": 0})
        row[state] = row.get(state, 0) + 1
    return list(people.values())
