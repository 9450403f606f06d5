"""The tables, all of them; import them from here. Nothing here knows the web or how studies run.

Times are UTC, timezone-aware. Ids are random UUID hex unless said otherwise. JSON columns hold plain data whose
shape is documented beside them and in docs/data-dictionary.md. After a change here draft the next revision:
`python -m desirepath.store.migrations "what changes"`; tests compare the newest revision with what stands here.
"""

from __future__ import annotations

from desirepath.store.models.asked import Event, HeadPose, ProblemReport, Response, StrokeRow, TrajectoryRow, Trial
from desirepath.store.models.base import Base, UtcDateTime, new_id, utc_now
from desirepath.store.models.coding import CodebookCode, Coding
from desirepath.store.models.lab import (
    Audit,
    Identity,
    Invitation,
    Note,
    RecoveryCode,
    SecondFactor,
    Setting,
    SignIn,
    SignInUnderWay,
    StudyRole,
    User,
)
from desirepath.store.models.learned import (
    Artefact,
    ArtefactAnswer,
    ArtefactParent,
    Job,
    JobAttempt,
    JobMetric,
    TaskFile,
)
from desirepath.store.models.robots import RobotRun, StudyRobot
from desirepath.store.models.server import RateWindow, ServerProcess, WorkerProcess
from desirepath.store.models.studies import (
    Erasing,
    Participant,
    ProtocolVersion,
    RecruitingId,
    Session,
    Study,
    Tombstone,
    protocol_digest,
)

__all__ = [
    "Artefact",
    "ArtefactAnswer",
    "ArtefactParent",
    "Audit",
    "Base",
    "CodebookCode",
    "Coding",
    "Erasing",
    "Event",
    "HeadPose",
    "Identity",
    "Invitation",
    "Job",
    "JobAttempt",
    "JobMetric",
    "Note",
    "Participant",
    "ProblemReport",
    "ProtocolVersion",
    "RateWindow",
    "RecoveryCode",
    "RecruitingId",
    "Response",
    "RobotRun",
    "SecondFactor",
    "ServerProcess",
    "Session",
    "Setting",
    "SignIn",
    "SignInUnderWay",
    "StrokeRow",
    "Study",
    "StudyRobot",
    "StudyRole",
    "TaskFile",
    "Tombstone",
    "TrajectoryRow",
    "Trial",
    "User",
    "UtcDateTime",
    "WorkerProcess",
    "new_id",
    "protocol_digest",
    "utc_now",
]
