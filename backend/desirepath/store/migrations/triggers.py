"""What the database itself refuses, as DDL for SQLite and PostgreSQL: the log and answers cannot be changed.

The key to the one way around it is a row in `erasing`, which only `store/erasure.py` writes and which never outlives
its transaction: rows of the named participant may then be deleted, nobody else's, and nothing may be changed.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Refusal:
    """Refuse `action` ("INSERT", "UPDATE", "UPDATE OF column" or "DELETE") on `table` with `message`.

    unless: SQL over OLD and NEW; where it is true, the change may happen.
    """

    name: str
    table: str
    action: str
    message: str
    unless: str | None = None

    def ddl(self, dialect: str) -> list[str]:
        """The statements that create it."""
        allowed = f"NOT ({self.unless})" if self.unless else None
        if dialect == "sqlite":
            when = f" WHEN {allowed}" if allowed else ""
            return [
                f'CREATE TRIGGER "{self.name}" BEFORE {self.action} ON "{self.table}"{when} '
                f"BEGIN SELECT RAISE(ABORT, '{self.message}'); END"
            ]
        back = "OLD" if self.action == "DELETE" else "NEW"
        refuse = f"RAISE EXCEPTION '{self.message}' USING ERRCODE = 'integrity_constraint_violation';"
        body = f"IF {allowed} THEN {refuse} END IF;" if allowed else refuse
        return [
            f'CREATE FUNCTION "{self.name}"() RETURNS trigger LANGUAGE plpgsql AS '
            f"$body$ BEGIN {body} RETURN {back}; END $body$",
            f'CREATE TRIGGER "{self.name}" BEFORE {self.action} ON "{self.table}" '
            f'FOR EACH ROW EXECUTE FUNCTION "{self.name}"()',
        ]

    def drop_ddl(self, dialect: str) -> list[str]:
        """The statements that remove it."""
        if dialect == "sqlite":
            return [f'DROP TRIGGER "{self.name}"']
        return [f'DROP TRIGGER "{self.name}" ON "{self.table}"', f'DROP FUNCTION "{self.name}"()']


ERASING_SESSION = (
    "EXISTS (SELECT 1 FROM erasing JOIN session ON session.participant_id = erasing.participant_id "
    "WHERE session.id = OLD.session_id)"
)
ERASING_STUDY = (
    "EXISTS (SELECT 1 FROM erasing JOIN participant ON participant.id = erasing.participant_id "
    "WHERE participant.study_id = OLD.study_id)"
)
ERASING_ABOUT = "EXISTS (SELECT 1 FROM erasing WHERE erasing.participant_id = OLD.participant_id)"
REFUSALS = (
    Refusal("event_never_updated", "event", "UPDATE", "events are append-only"),
    Refusal(
        "event_never_deleted", "event", "DELETE", "events are append-only", f"{ERASING_SESSION} OR {ERASING_STUDY}"
    ),
    Refusal("response_never_updated", "response", "UPDATE", "a response is never changed"),
    Refusal("response_never_deleted", "response", "DELETE", "a response is never deleted", ERASING_SESSION),
    Refusal(
        "participant_simulated_fixed",
        "participant",
        "UPDATE",
        "participant.simulated is set at creation",
        "OLD.simulated = NEW.simulated",
    ),
    Refusal(
        "session_simulated_fixed",
        "session",
        "UPDATE",
        "session.simulated and its participant are set at creation",
        "OLD.simulated = NEW.simulated AND OLD.participant_id = NEW.participant_id",
    ),
    Refusal(
        "session_simulated_as_participant",
        "session",
        "INSERT",
        "session.simulated must be as its participant.simulated",
        "NEW.simulated = (SELECT participant.simulated FROM participant WHERE participant.id = NEW.participant_id)",
    ),
    Refusal(
        "study_protocol_frozen",
        "study",
        "UPDATE",
        "the protocol of a study is frozen",
        "OLD.protocol_yaml = NEW.protocol_yaml AND OLD.protocol_hash = NEW.protocol_hash AND OLD.seed = NEW.seed",
    ),
    Refusal("tombstone_never_updated", "tombstone", "UPDATE", "tombstones stay"),
    Refusal("tombstone_never_deleted", "tombstone", "DELETE", "tombstones stay"),
    Refusal("protocol_version_never_updated", "protocol_version", "UPDATE", "a protocol version is frozen"),
    Refusal("protocol_version_never_deleted", "protocol_version", "DELETE", "protocol versions stay"),
    Refusal("audit_never_updated", "audit", "UPDATE", "the audit log is append-only"),
    Refusal(
        "audit_never_deleted",
        "audit",
        "DELETE",
        "the audit log is append-only",
        f"{ERASING_ABOUT} OR {ERASING_STUDY}",
    ),
    Refusal(
        "participant_pilot_fixed",
        "participant",
        "UPDATE",
        "participant.pilot is set at creation",
        "OLD.pilot = NEW.pilot",
    ),
    Refusal("stroke_drawn_never_updated", "stroke", "UPDATE OF drawn", "what was drawn is never changed"),
    Refusal("stroke_never_deleted", "stroke", "DELETE", "a stroke is never deleted", ERASING_SESSION),
    Refusal("stroke_walk_never_updated", "stroke", "UPDATE OF walk", "a walk is never changed", "OLD.walk IS NULL"),
)
HEAD_POSE_REFUSALS = (  # since 0005
    Refusal("head_pose_never_updated", "head_pose", "UPDATE", "how a head moved is never changed"),
    Refusal("head_pose_never_deleted", "head_pose", "DELETE", "how a head moved is never deleted", ERASING_SESSION),
)
