"""Takes participants in: code, place, plan, first session. What they do once they are in is `machine.py`'s."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from datetime import timedelta
from typing import TYPE_CHECKING, Any

from sqlalchemy import select
from sqlalchemy.orm import Session as DatabaseSession

from backend.store.artefacts import ArtefactStore
from backend.store.events import log_event
from backend.store.models import Participant, RecruitingId, Session, Study, new_id, utc_now
from backend.store.query_sets import require_files
from backend.study.kinds import stored
from backend.study.links import CODE_LETTERS, token_hash
from backend.study.plan.assignment import assign, people_taken
from backend.study.protocol.planning import PlanError, make_plan, session_seed
from backend.study.refusals import Refused
from backend.study.session.devices import fitted
from backend.study.session.versions import newest_protocol
from backend.study.studies import StudyError, queries_of_study

if TYPE_CHECKING:
    from backend.study.protocol.schema import Protocol

CODE_LENGTH = 5
TOKEN_BYTES = 24
SHOWN = ("trajectory", "trajectory_a", "trajectory_b")  # where a step says what it shows


def check_open(s: DatabaseSession, study: Study) -> None:
    """Raises Refused if nobody is taken in: 403 `closed`, 403 `full`."""
    _check_open(s, study, newest_protocol(s, study)[1].protocol)


def _check_open(s: DatabaseSession, study: Study, protocol: Protocol) -> None:
    if study.state != "open":
        raise Refused(403, "closed", "This study does not take anybody in at the moment.", study_id=study.id)
    if protocol.participants is not None and people_taken(s, study, protocol) >= protocol.participants:
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
    """A new participant with a session; returns it and the link's token, which is stored as a hash only.

    recruiting: {"platform", "external_id", ...} of a recruiting service; a second participant with the same id is
    refused. simulated and oracle mark a bot, for good. Raises Refused: closed, full, already_joined,
    device (with `reasons`).
    """
    study = s.get_one(Study, study.id)
    s.refresh(study, ["state", "pilot", "seed"], with_for_update=True)  # its protocol never changes, and is large
    number, frozen = newest_protocol(s, study)
    _check_open(s, study, frozen.protocol)
    now = utc_now()
    fit = fitted(frozen.protocol.device, device or {}, study_id=study.id, simulated=simulated)
    code = _new_code(s, study, simulated)
    participant = Participant(
        id=new_id(),
        study_id=study.id,
        code=code,
        simulated=simulated,
        pilot=study.pilot,
        oracle=dict(oracle) if oracle and simulated else None,
    )
    s.add(participant)
    s.flush()
    if recruiting and recruiting.get("external_id") and not simulated:  # a bot must not take a person's place
        _keep_recruiting_id(s, study, participant, recruiting)
    seed = session_seed(study.seed, code)
    place, assignment = assign(s, study, frozen.protocol, seed=seed, simulated=simulated, now=now)
    try:
        queries = queries_of_study(s, files, study, number, whole=False)
        plan = make_plan(frozen.protocol, seed, queries, place)
        kept = stored(plan)
        require_files(files, {step[name] for step in kept for name in SHOWN if step.get(name)})
    except (PlanError, ValueError) as problem:
        raise StudyError(f"study {study.name!r}: {problem}") from problem
    token = secrets.token_urlsafe(TOKEN_BYTES)
    session = Session(
        participant_id=participant.id,
        study_id=study.id,
        token_hash=token_hash(token),
        language=language if language in frozen.protocol.languages else frozen.protocol.languages[0],
        simulated=simulated,
        seed=seed,
        plan=kept,
        device=fit,
        assignment=assignment,
        protocol_number=number,
        created_at=now,
        last_seen_at=now,
        expires_at=now + timedelta(days=frozen.protocol.link_valid_days),
    )
    s.add(session)
    s.flush()
    log_event(s, "joined", study_id=study.id, session_id=session.id, simulated=simulated, language=session.language)
    log_event(s, "step_entered", study_id=study.id, session_id=session.id, step=plan[0].key)
    return session, token


def _new_code(s: DatabaseSession, study: Study, simulated: bool) -> str:
    """P-7K3QM for people, by lot, so that nothing can be told from it; S001 on for bots, so that runs repeat."""
    taken = set(s.scalars(select(Participant.code).where(Participant.study_id == study.id)))
    if simulated:
        number = 1 + max((int(code[1:]) for code in taken if code.startswith("S")), default=0)
        return f"S{number:03d}"
    while True:
        code = "P-" + "".join(secrets.choice(CODE_LETTERS) for _ in range(CODE_LENGTH))
        if code not in taken:
            return code


def _keep_recruiting_id(
    s: DatabaseSession, study: Study, participant: Participant, recruiting: Mapping[str, Any]
) -> None:
    platform, external_id = str(recruiting.get("platform", "unknown"))[:40], str(recruiting["external_id"])[:200]
    known = s.scalars(
        select(RecruitingId.participant_id).where(
            RecruitingId.study_id == study.id,
            RecruitingId.platform == platform,
            RecruitingId.external_id == external_id,
        )
    ).first()
    if known is not None:
        raise Refused(409, "already_joined", "This person takes part already.", study_id=study.id)
    s.add(
        RecruitingId(
            participant_id=participant.id,
            study_id=study.id,
            platform=platform,
            external_id=external_id,
            details={k: str(v)[:200] for k, v in recruiting.items() if k not in ("platform", "external_id")},
        )
    )
    s.flush()
