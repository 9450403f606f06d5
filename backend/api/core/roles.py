"""What each role may do, for every signed-in route, in one table. Who is signed in is decided in `auth.py`.

Roles are given for the whole installation. A route that changes something and stands in no line of CHANGING is refused
to everybody; a route that only shows needs LOOK, unless SHOWING says more.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Right(StrEnum):
    """One thing that a role may do."""

    LOOK = "look"  # every page: studies, people, answers, jobs, policies
    RUN = "run"  # open and close studies, recruit, write notes, exclude
    ERASE = "erase"  # destroy a participant's data
    TAKE = "take"  # take data sets and learned things away as files
    PAY = "pay"  # see the platform's ids of recruited people beside their codes
    ANALYSE = "analyse"  # snapshots and jobs
    MANAGE = "manage"  # accounts and roles, settings, the audit log, how long data are kept


EXPERIMENTER = frozenset({Right.LOOK, Right.RUN, Right.ERASE, Right.TAKE, Right.PAY})
ANALYST = frozenset({Right.LOOK, Right.TAKE, Right.ANALYSE})
ROLES: dict[str, frozenset[Right]] = {
    "owner": frozenset(Right),
    "researcher": EXPERIMENTER | ANALYST,  # one person who does both, as in small labs
    "experimenter": EXPERIMENTER,
    "analyst": ANALYST,
    "viewer": frozenset({Right.LOOK}),
}


@dataclass(frozen=True)
class Rule:
    """What a route needs. `action`: what the audit log calls it; None: not written there."""

    right: Right
    action: str | None = None


LOOKING = Rule(Right.LOOK)
CHANGING: dict[str, Rule] = {
    "/lab/sign-out": LOOKING,
    "/lab/password": Rule(Right.LOOK, "password_changed"),
    "/lab/new": Rule(Right.RUN),
    "/lab/new/{draft_id}": Rule(Right.RUN),
    "/lab/new/{draft_id}/open": Rule(Right.RUN, "study_created"),
    "/lab/preview-stage/{token}/{side}": LOOKING,
    "/lab/studies/{study_id}/state": Rule(Right.RUN, "study_state_changed"),
    "/lab/studies/{study_id}/revise": Rule(Right.RUN),
    "/lab/studies/{study_id}/revise/{draft_id}": Rule(Right.RUN),
    "/lab/studies/{study_id}/revise/{draft_id}/open": Rule(Right.RUN, "study_revised"),
    "/lab/studies/{study_id}/pilot": Rule(Right.RUN, "study_pilot_changed"),
    "/lab/studies/{study_id}/retention": Rule(Right.MANAGE, "retention_changed"),
    "/lab/studies/{study_id}/export": Rule(Right.TAKE, "study_exported"),
    "/lab/studies/{study_id}/people/{code}/notes": Rule(Right.RUN, "note_written"),
    "/lab/studies/{study_id}/people/{code}/notes/{note_id}/remove": Rule(Right.RUN, "note_removed"),
    "/lab/studies/{study_id}/people/{code}/exclude": Rule(Right.RUN, "participant_excluded"),
    "/lab/studies/{study_id}/people/{code}/include": Rule(Right.RUN, "participant_included"),
    "/lab/studies/{study_id}/people/{code}/erase": Rule(Right.ERASE, "participant_erased"),
    "/lab/studies/{study_id}/paths/{stroke_id}/leave-out": Rule(Right.ANALYSE, "path_left_out"),
    "/lab/studies/{study_id}/paths/{stroke_id}/take-back": Rule(Right.ANALYSE, "path_taken_back"),
    "/lab/studies/{study_id}/paths/train": Rule(Right.ANALYSE, "job_started"),
    "/lab/settings": Rule(Right.MANAGE, "settings_changed"),
    "/lab/settings/accounts": Rule(Right.MANAGE, "account_added"),
    "/lab/settings/accounts/{name}/role": Rule(Right.MANAGE, "role_changed"),
    "/lab/settings/accounts/{name}/reset": Rule(Right.MANAGE, "password_reset"),
    "/lab/settings/accounts/{name}/remove": Rule(Right.MANAGE, "account_removed"),
    "/lab/snapshots": Rule(Right.ANALYSE, "snapshot_taken"),
    "/lab/jobs/new/{kind_name}": Rule(Right.ANALYSE, "job_started"),
    "/lab/jobs/{job_id}/cancel": Rule(Right.ANALYSE, "job_cancelled"),
    "/lab/jobs/{job_id}/retry": Rule(Right.ANALYSE, "job_retried"),
}
SHOWING: dict[str, Rule] = {
    "/lab/new": Rule(Right.RUN),
    "/lab/new/{draft_id}": Rule(Right.RUN),
    "/lab/new/{draft_id}/preview/{number}": Rule(Right.RUN),
    "/lab/studies/{study_id}/recruit": Rule(Right.RUN),
    "/lab/studies/{study_id}/payments": Rule(Right.PAY, "payments_seen"),
    "/lab/studies/{study_id}/payments.csv": Rule(Right.PAY, "payments_taken"),
    "/lab/studies/{study_id}/revise": Rule(Right.RUN),
    "/lab/studies/{study_id}/revise/{draft_id}": Rule(Right.RUN),
    "/lab/studies/{study_id}/revise/{draft_id}/preview/{number}": Rule(Right.RUN),
    "/lab/studies/{study_id}/analysis/{who}/report.zip": Rule(Right.TAKE, "report_taken"),
    "/lab/studies/{study_id}/analysis/{who}/{name:path}.csv": Rule(Right.TAKE, "report_taken"),
    "/lab/studies/{study_id}/analysis/{who}/{name:path}.json": Rule(Right.TAKE, "report_taken"),
    "/lab/studies/{study_id}/people/{code}/learnt.csv": Rule(Right.TAKE),
    "/lab/studies/{study_id}/paths/{environment}-{pair}.csv": Rule(Right.TAKE),
    "/lab/studies/{study_id}/protocol.yaml": Rule(Right.TAKE),  # may hold the completion code, which is worth money
    "/lab/settings": Rule(Right.MANAGE),
    "/lab/audit": Rule(Right.MANAGE),
    "/lab/jobs/new": Rule(Right.ANALYSE),
    "/lab/jobs/new/{kind_name}": Rule(Right.ANALYSE),
    "/lab/artefacts/{artefact_id}/content": Rule(Right.TAKE, "artefact_taken"),
    "/lab/policies/{artefact_id}/policy.zip": Rule(Right.TAKE, "artefact_taken"),
    "/lab/policies/{artefact_id}/policy.onnx": Rule(Right.TAKE, "artefact_taken"),
}


def rule_of(method: str, route: str) -> Rule | None:
    """What a request needs; `route` is the pattern, as `/lab/studies/{study_id}`. None: nobody may."""
    if method in ("GET", "HEAD", "OPTIONS"):
        return SHOWING.get(route, LOOKING)
    return CHANGING.get(route)


def may(role: str, right: Right | str) -> bool:
    """Whether a role has a right; a role that is none of ours has no rights."""
    return right in ROLES.get(role, frozenset())
