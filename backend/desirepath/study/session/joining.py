"""Takes participants in: code, place, plan, first session. What they do once they are in is `machine.py`'s."""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import TYPE_CHECKING, Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.events import log_event
from desirepath.store.models import Participant, RecruitingId, Session, Study, new_id, utc_now
from desirepath.store.query_sets import StoredQuery, require_files
from desirepath.store.worker_signals import Signal, signal_workers
from desirepath.study.kind import dump_plan
from desirepath.study.links import CODE_LETTERS, token_hash
from desirepath.study.plan.assignment import Places
from desirepath.study.protocol.planning import PlanError, make_plan, session_seed
from desirepath.study.refusals import Refused
from desirepath.study.session.devices import fit_device
from desirepath.study.session.platforms import is_id
from desirepath.study.session.versions import newest_protocol
from desirepath.study.studies import StudyError, queries_of_study

if TYPE_CHECKING:
    from desirepath.study.plan.counterbalancing import Place
    from desirepath.study.protocol.schema import Protocol
    from desirepath.study.steps import Step

CODE_LENGTH = 5
TOKEN_BYTES = 24
UNFILLED = "placeholder_unfilled"  # kind of event: a platform's link was opened without an id in it
SHOWN = ("trajectory", "trajectory_a", "trajectory_b")  # where a step says what it shows


@dataclass(frozen=True)
class Joiner:
    """Somebody who asks to take part.

    recruiting: {"platform", "external_id", ...} of a recruiting service; a second participant with the same id, in
    small or capital letters, is refused. unfilled: parameters that came with a placeholder instead, which is noted.
    simulated and oracle mark a bot, for good.
    """

    language: str
    recruiting: Mapping[str, Any] | None = None
    device: Mapping[str, Any] | None = None
    simulated: bool = False
    oracle: Mapping[str, Any] | None = None
    unfilled: Sequence[str] = ()


@dataclass(frozen=True)
class TakenIn:
    """A new participant's session; `token`: of the link, which is stored as a hash only."""

    participant: Participant
    session: Session
    token: str


def check_open(s: DatabaseSession, study: Study) -> None:
    """Raises Refused if nobody is taken in: 403 `closed`, 403 `full`."""
    protocol = newest_protocol(s, study)[1].protocol
    _check_open(study, Places(s, study, protocol, now=utc_now()))


def _check_open(study: Study, places: Places) -> None:
    if study.state != "open":
        raise Refused(403, "closed", "This study does not take anybody in at the moment.", study_id=study.id)
    if places.is_full:
        raise Refused(403, "full", "This study has all the participants it needs.", study_id=study.id)


def join_study(
    s: DatabaseSession,
    study: Study,
    *,
    language: str,
    recruiting: Mapping[str, Any] | None = None,
    device: Mapping[str, Any] | None = None,
    simulated: bool = False,
    oracle: Mapping[str, Any] | None = None,
    files: ArtefactStore,
) -> tuple[Session, str]:
    """A new participant with a session; returns it and the link's token. What is asked: see `Joiner`.

    Raises Refused: closed, full, already_joined, device (with `reasons`).
    """
    who = Joiner(language, recruiting, device, simulated, oracle)
    (done,) = join_together(s, study, [who], files=files)
    if isinstance(done, Exception):
        raise done
    return done.session, done.token


def join_together(
    s: DatabaseSession, study: Study, joiners: Sequence[Joiner], *, files: ArtefactStore
) -> list[TakenIn | Refused | StudyError]:
    """Take several in, in their order, in one transaction: each as if alone, refusals in the place of who is refused.

    What everybody needs of the study is read once, and all that is new is written in one go: half of what one join
    alone takes is the same for all of them.
    """
    study = s.get_one(Study, study.id)
    s.refresh(study, ["state", "pilot", "seed"], with_for_update=True)  # its protocol never changes, and is large
    number, frozen = newest_protocol(s, study)
    door = _Door(s, study, number, frozen.protocol, files)
    done: list[TakenIn | Refused | StudyError] = []
    for who in joiners:
        try:
            done.append(door.let_in(who))
        except (Refused, StudyError) as refused:
            done.append(refused)
    door.write()
    return done


class _Door:
    """Lets people into one study within one transaction, which holds the study's lock."""

    def __init__(self, s: DatabaseSession, study: Study, number: int, protocol: Protocol, files: ArtefactStore) -> None:
        self._s, self._study, self._number, self._protocol, self._files = s, study, number, protocol, files
        self._now = utc_now()
        self._places = Places(s, study, protocol, now=self._now)
        self._codes = set(s.scalars(select(Participant.code).where(Participant.study_id == study.id)))
        self._queries: list[StoredQuery] | None = None
        self._there: set[str] = set()  # trajectories whose files were looked for
        self._joined: list[TakenIn] = []
        self._first_keys: list[str] = []
        self._recruiting_ids: dict[tuple[str, str], RecruitingId] = {}
        self._unfilled: dict[str, Sequence[str]] = {}  # by session

    def let_in(self, who: Joiner) -> TakenIn:
        """Raises Refused and StudyError, and has then done nothing."""
        study, protocol = self._study, self._protocol
        _check_open(study, self._places)
        fit = fit_device(protocol.device, who.device or {}, study_id=study.id, simulated=who.simulated)
        participant = Participant(
            id=new_id(),
            study_id=study.id,
            code=self._new_code(who.simulated),
            simulated=who.simulated,
            pilot=study.pilot and not who.simulated,  # a simulated participant is one whatever the phase
            oracle=dict(who.oracle) if who.oracle and who.simulated else None,
        )
        known = self._recruiting_id(participant, who.recruiting or {})
        seed = session_seed(study.seed, participant.code)
        place, assignment = self._places.next(seed=seed, simulated=who.simulated)
        plan, stored = self._plan(seed, place)
        token = secrets.token_urlsafe(TOKEN_BYTES)
        session = Session(
            id=new_id(),
            participant_id=participant.id,
            study_id=study.id,
            token_hash=token_hash(token),
            language=who.language if who.language in protocol.languages else protocol.languages[0],
            simulated=who.simulated,
            seed=seed,
            plan=stored,
            device=fit,
            assignment=assignment,
            protocol_number=self._number,
            created_at=self._now,
            step_since=self._now,
            last_seen_at=self._now,
            expires_at=self._now + timedelta(days=protocol.link_valid_days),
        )
        self._places.take(assignment, simulated=who.simulated)
        self._codes.add(participant.code)
        if known is not None:
            self._recruiting_ids[known.platform, known.external_id.lower()] = known
        if who.unfilled and not who.simulated:
            self._unfilled[session.id] = who.unfilled
        self._joined.append(TakenIn(participant, session, token))
        self._first_keys.append(plan[0].key)
        return self._joined[-1]

    def write(self) -> None:
        """Store everybody who was let in, and the log's lines on them."""
        self._s.add_all(taken_in.participant for taken_in in self._joined)
        self._s.flush()
        self._s.add_all([*self._recruiting_ids.values(), *(taken_in.session for taken_in in self._joined)])
        self._s.flush()
        if self._joined:
            signal_workers(self._s, Signal.PARTICIPANT_PRESENT)
        for joined, key in zip(self._joined, self._first_keys, strict=True):
            session, study = joined.session, joined.session.study_id
            kind, language = session.simulated, session.language
            log_event(self._s, "joined", study_id=study, session_id=session.id, simulated=kind, language=language)
            if unfilled := self._unfilled.get(session.id):
                log_event(self._s, UNFILLED, study_id=study, session_id=session.id, parameters=list(unfilled))
            log_event(self._s, "step_entered", study_id=study, session_id=session.id, step=key)

    def _plan(self, seed: int, place: Place) -> tuple[list[Step], list[dict[str, Any]]]:
        """The steps, and as they are stored. Raises StudyError."""
        try:
            if self._queries is None:
                self._queries = queries_of_study(self._s, self._files, self._study, self._number, whole=False)
            plan = make_plan(self._protocol, seed, self._queries, place)
            stored = dump_plan(plan)
            shown = {step[name] for step in stored for name in SHOWN if step.get(name)} - self._there
            require_files(self._files, shown)
            self._there |= shown
        except (PlanError, ValueError) as problem:
            raise StudyError(f"study {self._study.name!r}: {problem}") from problem
        return plan, stored

    def _new_code(self, simulated: bool) -> str:
        """P-7K3QM for people, by lot, so that nothing can be told from it; S001 on for bots, so that runs repeat."""
        if simulated:
            number = 1 + max((int(code[1:]) for code in self._codes if code.startswith("S")), default=0)
            return f"S{number:03d}"
        while True:
            code = "P-" + "".join(secrets.choice(CODE_LETTERS) for _ in range(CODE_LENGTH))
            if code not in self._codes:
                return code

    def _recruiting_id(self, participant: Participant, recruiting: Mapping[str, Any]) -> RecruitingId | None:
        """What a platform calls the participant. Raises Refused where it is somebody who takes part already, and
        ValueError for an id that `platforms.sender_of` did not let through."""
        if not recruiting.get("external_id") or participant.simulated:  # a bot must not take a person's place
            return None
        platform, external_id = str(recruiting.get("platform", "unknown")), str(recruiting["external_id"])
        if not is_id(external_id):
            raise ValueError(f"external_id {external_id[:100]!r} is no platform's id")
        known = select(RecruitingId.participant_id).where(
            RecruitingId.study_id == self._study.id,
            RecruitingId.platform == platform,
            func.lower(RecruitingId.external_id) == external_id.lower(),
        )
        if (platform, external_id.lower()) in self._recruiting_ids or self._s.scalars(known).first() is not None:
            raise Refused(409, "already_joined", "This person takes part already.", study_id=self._study.id)
        return RecruitingId(
            participant_id=participant.id,
            study_id=self._study.id,
            platform=platform,
            external_id=external_id,
            details={k: str(v) for k, v in recruiting.items() if k not in ("platform", "external_id")},
        )


def is_of(known: RecruitingId, recruiting: Mapping[str, Any]) -> bool:
    """Whether a platform's link names the person of that id; capitals make nobody else of them."""
    known_as = (known.platform, known.external_id.lower())
    return known_as == (recruiting["platform"], str(recruiting["external_id"]).lower())
