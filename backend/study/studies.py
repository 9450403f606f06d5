"""Opens studies and takes participants in. What they do once they are in is `machine.py`'s."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from datetime import timedelta
from typing import Any

from sqlalchemy import func, or_, select
from sqlalchemy.orm import Session as DatabaseSession

from backend.store.artefacts import ArtefactStore
from backend.store.events import log_event
from backend.store.models import Artefact, Participant, RecruitingId, Session, Study, new_id, utc_now
from backend.store.query_sets import StoredQuery, import_query_set, queries_of
from backend.study.planning import PlanError, make_plan, queries_needed, session_seed
from backend.study.protocol import FrozenProtocol, thaw
from backend.study.refusals import Refused
from backend.study.sessions import token_hash

CODE_LETTERS = "23456789ABCDEFGHJKMNPQRSTUVWXYZ"  # nothing that is easily misread
CODE_LENGTH = 5
TOKEN_BYTES = 24


class StudyError(ValueError):
    """A study that cannot be opened; says why and what would work."""


def create_study(
    s: DatabaseSession,
    files: ArtefactStore,
    frozen: FrozenProtocol,
    *,
    name: str,
    created_by: str | None,
    query_set: Artefact | None = None,
) -> Study:
    """Open a study with its own frozen copy of the protocol.

    query_set: an artefact of the store; default the one that the protocol names, brought into the store if it is not
    there yet. Raises StudyError for a query set that is missing, empty or too small, or a name that is empty.
    """
    if not name.strip():
        raise StudyError("name: a study needs one")
    wanted = frozen.protocol.query_set
    try:
        artefact = query_set or import_query_set(s, files, wanted)
        queries = queries_of(s, files, artefact.id)
    except ValueError as problem:
        raise StudyError(f"query_set = {wanted!r}: {problem}") from problem
    if len(queries) < queries_needed(frozen.protocol):
        raise StudyError(
            f"query_set = {wanted!r}: has {len(queries)} queries, one session needs {queries_needed(frozen.protocol)}; "
            "generate more (`desirepath queries generate`) or ask for fewer"
        )
    study = Study(
        id=new_id(),
        name=name.strip()[:200],
        protocol_name=frozen.protocol.protocol,
        protocol_version=frozen.protocol.version,
        protocol_yaml=frozen.yaml,
        protocol={**frozen.data, "materials": {"query_set": artefact.id, "setup": artefact.setup}},
        files=frozen.files,
        protocol_hash=frozen.hash,
        recruiting_token=secrets.token_urlsafe(TOKEN_BYTES),
        seed=frozen.protocol.assignment.seed,
        created_by=created_by,
    )
    s.add(study)
    s.flush()
    log_event(s, "study_created", study_id=study.id, protocol=study.protocol_name, hash=study.protocol_hash)
    return study


def study_by_link(s: DatabaseSession, recruiting_token: str) -> Study:
    """The study of a recruiting link. Raises Refused 404 `unknown`."""
    study = s.scalars(select(Study).where(Study.recruiting_token == recruiting_token)).first()
    if study is None:
        raise Refused(404, "unknown", "This link does not lead to a study.")
    return study


def check_open(s: DatabaseSession, study: Study) -> None:
    """Raises Refused if nobody is taken in: 403 `closed`, 403 `full`."""
    if study.state != "open":
        raise Refused(403, "closed", "This study does not take anybody in at the moment.", study_id=study.id)
    limit = study.protocol.get("participants")
    if limit is not None and _taken(s, study) >= limit:
        raise Refused(403, "full", "This study has all the participants it needs.", study_id=study.id)


def _taken(s: DatabaseSession, study: Study) -> int:
    """People who count: in or done, not excluded, withdrawn, expired or simulated; a pilot's only while it is one."""
    counted = (
        select(func.count(func.distinct(Participant.id)))
        .join(Session, Session.participant_id == Participant.id)
        .where(
            Participant.study_id == study.id,
            Participant.simulated.is_(False),
            Participant.pilot.is_(study.pilot),
            Participant.excluded_at.is_(None),
            Participant.withdrawn_at.is_(None),
            or_(
                Session.state == "completed",
                # nobody may ever look again at a session whose time is over, so its state still says active
                Session.state.in_(("active", "paused")) & (Session.expires_at > utc_now()),
            ),
        )
    )
    return s.scalar(counted) or 0


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
    refused. simulated and oracle mark a bot, for good. Raises Refused: closed, full, already_joined.
    """
    study = s.scalars(
        select(Study).where(Study.id == study.id).with_for_update().execution_options(populate_existing=True)
    ).one()
    check_open(s, study)
    frozen = thaw(study)
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
    try:
        plan = make_plan(frozen.protocol, seed, queries_of_study(s, files, study))
    except (PlanError, ValueError) as problem:
        raise StudyError(f"study {study.name!r}: {problem}") from problem
    token = secrets.token_urlsafe(TOKEN_BYTES)
    now = utc_now()
    session = Session(
        participant_id=participant.id,
        study_id=study.id,
        token_hash=token_hash(token),
        language=language if language in frozen.protocol.languages else frozen.protocol.languages[0],
        simulated=simulated,
        seed=seed,
        plan=plan,
        device=dict(device or {}),
        created_at=now,
        last_seen_at=now,
        expires_at=now + timedelta(days=frozen.protocol.link_valid_days),
    )
    s.add(session)
    s.flush()
    log_event(s, "joined", study_id=study.id, session_id=session.id, simulated=simulated, language=session.language)
    log_event(s, "step_entered", study_id=study.id, session_id=session.id, step=plan[0]["key"])
    return session, token


def queries_of_study(s: DatabaseSession, files: ArtefactStore, study: Study) -> list[StoredQuery]:
    """The queries that the study draws from."""
    return queries_of(s, files, study.protocol["materials"]["query_set"])


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
