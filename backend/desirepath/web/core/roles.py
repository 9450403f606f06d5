"""What each role may do, for every signed-in route, in one table. Who is signed in is decided in `auth.py`.

An account has one role for the whole installation and any number in single studies; they add up (`Rights`). A route
that changes something and stands in no line of CHANGING is refused to everybody; a route that only shows needs LOOK,
unless SHOWING says more. Which study a request is about is found in `permits.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum


class Right(StrEnum):
    """One thing that a role may do."""

    LOOK = "look"  # every page: studies, people, answers, jobs, policies
    RUN = "run"  # open and close studies, recruit, write notes, exclude
    ERASE = "erase"  # destroy a participant's data
    TAKE = "take"  # take data sets and learned things away as files
    PAY = "pay"  # see the platform's ids of recruited people beside their codes
    CODE = "code"  # read what participants wrote in their own words by the lab's codebook
    ANALYSE = "analyse"  # take snapshots, start jobs
    PLAN = "plan"  # have the power of a study computed, which takes minutes of processor
    TIDY = "tidy"  # cancel and retry jobs; rename, archive and delete what they made
    EQUIP = "equip"  # bring, train, take away and remove setups, which are the installation's
    MANAGE = "manage"  # roles, how long data are kept; of the installation: accounts, settings, the audit log


SHARED = frozenset({Right.LOOK, Right.TAKE, Right.ANALYSE})
"""Of what belongs to no study (shipped policies, lists, launch forms) these are enough in any one study."""

EXPERIMENTER = frozenset({Right.LOOK, Right.RUN, Right.ERASE, Right.TAKE, Right.PAY, Right.PLAN, Right.CODE})
ANALYST = frozenset({Right.LOOK, Right.TAKE, Right.ANALYSE, Right.TIDY, Right.EQUIP, Right.PLAN, Right.CODE})
ROLES: dict[str, frozenset[Right]] = {
    "owner": frozenset(Right),
    "researcher": EXPERIMENTER | ANALYST,  # one person who does both, as in small labs
    "experimenter": EXPERIMENTER,
    "analyst": ANALYST,
    "viewer": frozenset({Right.LOOK}),
    "member": frozenset(),  # has only the roles of single studies
}
STUDY_ROLES = ("owner", "experimenter", "analyst", "viewer")
"""What may be given in a single study; `researcher` is two of them."""


@dataclass(frozen=True)
class Rights:
    """What somebody may do. everywhere: by the installation's role; in_study: id -> by the roles given there."""

    everywhere: frozenset[Right] = frozenset()
    in_study: Mapping[str, frozenset[Right]] = field(default_factory=dict)

    def may(self, right: Right | str, study_id: str | None = None) -> bool:
        """Whether it may be done in a study; without one, with what belongs to none (`SHARED`)."""
        if right in self.everywhere:
            return True
        if study_id is None:
            return right in SHARED and any(right in given for given in self.in_study.values())
        return right in self.in_study.get(study_id, frozenset())

    def studies(self, right: Right | str) -> frozenset[str] | None:
        """Ids of the studies in which it may be done; None: in every one."""
        if right in self.everywhere:
            return None
        return frozenset(study for study, given in self.in_study.items() if right in given)


def rights_of(role: str, given: Iterable[tuple[str, str]] = ()) -> Rights:
    """The rights of an installation's role with those `given` in studies: (study, role). Unknown roles have none."""
    in_study: dict[str, frozenset[Right]] = {}
    for study, one in given:
        in_study[study] = in_study.get(study, frozenset()) | ROLES.get(one, frozenset())
    return Rights(ROLES.get(role, frozenset()), in_study)


@dataclass(frozen=True)
class Rule:
    """What a route needs; `right` None: only to be signed in. `action`: what the audit log calls it; None: not written
    there."""

    right: Right | None
    action: str | None = None


LOOKING = Rule(Right.LOOK)
SIGNED_IN = Rule(None)
CHANGING: dict[str, Rule] = {
    "/lab/sign-out": SIGNED_IN,
    "/lab/password": Rule(None, "password_changed"),
    "/lab/account/sign-ins/{sign_in_id}/end": Rule(None, "sign_in_ended"),
    "/lab/account/sign-ins-elsewhere/end": Rule(None, "sign_ins_ended"),
    "/lab/account/second-factor/begin": SIGNED_IN,
    "/lab/account/second-factor/confirm": Rule(None, "second_factor_set"),
    "/lab/account/second-factor/codes": Rule(None, "recovery_codes_renewed"),
    "/lab/account/second-factor/remove": Rule(None, "second_factor_removed"),
    "/lab/account/identity/link": Rule(None, "identity_linked"),
    "/lab/account/identity/{identity_id}/remove": Rule(None, "identity_removed"),
    "/lab/new": Rule(Right.RUN),
    "/lab/new/{draft_id}": Rule(Right.RUN),
    "/lab/new/{draft_id}/power": Rule(Right.RUN),
    "/lab/new/{draft_id}/edit": Rule(Right.RUN),
    "/lab/studies/{study_id}/power": Rule(Right.PLAN),
    "/lab/new/{draft_id}/open": Rule(Right.RUN, "study_created"),
    "/lab/preview-stage/{token}/{side}": LOOKING,
    "/lab/studies/{study_id}/remove-example": Rule(Right.ERASE, "example_removed"),
    "/lab/studies/{study_id}/state": Rule(Right.RUN, "study_state_changed"),
    "/lab/studies/{study_id}/revise": Rule(Right.RUN),
    "/lab/studies/{study_id}/revise/{draft_id}": Rule(Right.RUN),
    "/lab/studies/{study_id}/revise/{draft_id}/open": Rule(Right.RUN, "study_revised"),
    "/lab/studies/{study_id}/pilot": Rule(Right.RUN, "study_pilot_changed"),
    "/lab/studies/{study_id}/retention": Rule(Right.MANAGE, "retention_changed"),
    "/lab/studies/{study_id}/team": Rule(Right.MANAGE, "study_roles_changed"),
    "/lab/studies/{study_id}/export": Rule(Right.TAKE, "study_exported"),
    "/lab/studies/{study_id}/robots": Rule(Right.RUN, "robot_admitted"),
    "/lab/studies/{study_id}/robots/{robot_id}/revoke": Rule(Right.RUN, "robot_revoked"),
    "/lab/studies/{study_id}/robots/{robot_id}/drive": Rule(Right.RUN, "robot_started"),
    "/lab/studies/{study_id}/robots/{robot_id}/stop": Rule(Right.RUN, "robot_stopped"),
    "/lab/studies/{study_id}/robot-runs/{run_id}/skip": Rule(Right.RUN, "robot_run_skipped"),
    "/api/lab/studies/{study_id}/robots/{robot_id}/weights": Rule(Right.RUN),
    "/api/lab/studies/{study_id}/robots/{robot_id}/person": Rule(Right.RUN),
    "/api/lab/studies/{study_id}/robots/{robot_id}/words": Rule(Right.RUN),
    "/lab/studies/{study_id}/people/{code}/notes": Rule(Right.RUN, "note_written"),
    "/lab/studies/{study_id}/people/{code}/notes/{note_id}/remove": Rule(Right.RUN, "note_removed"),
    "/lab/studies/{study_id}/people/{code}/exclude": Rule(Right.RUN, "participant_excluded"),
    "/lab/studies/{study_id}/people/{code}/include": Rule(Right.RUN, "participant_included"),
    "/lab/studies/{study_id}/people/{code}/erase": Rule(Right.ERASE, "participant_erased"),
    "/lab/studies/{study_id}/paths/{stroke_id}/leave-out": Rule(Right.ANALYSE, "path_left_out"),
    "/lab/studies/{study_id}/paths/{stroke_id}/take-back": Rule(Right.ANALYSE, "path_taken_back"),
    "/lab/studies/{study_id}/paths/train": Rule(Right.ANALYSE, "job_started"),
    "/lab/studies/{study_id}/coding/{item}/codes": Rule(Right.CODE, "codebook_changed"),
    "/lab/studies/{study_id}/coding/{item}/codes/{code_id}/remove": Rule(Right.CODE, "codebook_changed"),
    "/lab/studies/{study_id}/coding/{item}/answers/{response_id}": Rule(Right.CODE),
    "/lab/studies/{study_id}/coding/{item}/answers/{response_id}/settle": Rule(Right.CODE),
    "/lab/settings": Rule(Right.MANAGE, "settings_changed"),
    "/lab/settings/setups": Rule(Right.EQUIP, "setup_brought"),
    "/lab/settings/setups/{name}/train": Rule(Right.EQUIP, "job_started"),
    "/lab/settings/setups/{name}/remove": Rule(Right.EQUIP, "setup_removed"),
    "/lab/settings/accounts": Rule(Right.MANAGE, "account_added"),
    "/lab/settings/accounts/{name}/role": Rule(Right.MANAGE, "role_changed"),
    "/lab/settings/accounts/{name}/reset": Rule(Right.MANAGE, "password_reset"),
    "/lab/settings/accounts/{name}/sign-out": Rule(Right.MANAGE, "account_signed_out"),
    "/lab/settings/accounts/{name}/second-factor/remove": Rule(Right.MANAGE, "second_factor_removed"),
    "/lab/settings/invitations": Rule(Right.MANAGE, "invited"),
    "/lab/settings/invitations/{invitation_id}/withdraw": Rule(Right.MANAGE, "invitation_withdrawn"),
    "/lab/settings/accounts/{name}/identities/{identity_id}/remove": Rule(Right.MANAGE, "identity_removed"),
    "/lab/settings/accounts/{name}/remove": Rule(Right.MANAGE, "account_removed"),
    "/lab/snapshots": Rule(Right.ANALYSE, "snapshot_taken"),
    "/lab/reward-files": Rule(Right.ANALYSE, "reward_taken_in"),
    "/api/lab/recordings/files": Rule(Right.ANALYSE),
    "/lab/recordings/example": Rule(Right.ANALYSE),
    "/lab/recordings/{draft_id}": Rule(Right.ANALYSE),
    "/lab/recordings/{draft_id}/keep": Rule(Right.ANALYSE, "recordings_imported"),
    "/lab/recordings/{draft_id}/discard": Rule(Right.ANALYSE, "recordings_discarded"),
    "/lab/rewards/{artefact_id}/looks-right": Rule(Right.ANALYSE, "reward_looks_right"),
    "/lab/policy-files": Rule(Right.ANALYSE, "policy_taken_in"),
    "/lab/jobs/new/{kind_name}": Rule(Right.ANALYSE, "job_started"),
    "/lab/artefacts/{artefact_id}/rename": Rule(Right.TIDY, "artefact_renamed"),
    "/lab/artefacts/{artefact_id}/archive": Rule(Right.TIDY, "artefact_archived"),
    "/lab/artefacts/{artefact_id}/restore": Rule(Right.TIDY, "artefact_restored"),
    "/lab/artefacts/{artefact_id}/delete": Rule(Right.TIDY, "artefact_deleted"),
    "/lab/jobs/{job_id}/cancel": Rule(Right.TIDY, "job_cancelled"),
    "/lab/jobs/{job_id}/retry": Rule(Right.TIDY, "job_retried"),
}
SHOWING: dict[str, Rule] = {
    "/lab/guides": SIGNED_IN,
    "/lab/guides/{name}": SIGNED_IN,
    "/lab/guides/images/{name}": SIGNED_IN,
    "/lab/studies": SIGNED_IN,  # lists those that may be looked at
    "/lab/password": SIGNED_IN,
    "/lab/account": SIGNED_IN,
    "/lab/account/second-factor": SIGNED_IN,
    "/lab/account/identity": SIGNED_IN,
    "/lab/account/identity/begin": SIGNED_IN,
    "/lab/new": Rule(Right.RUN),
    "/lab/new/{draft_id}": Rule(Right.RUN),
    "/lab/new/{draft_id}/power": Rule(Right.RUN),
    "/lab/new/{draft_id}/power/{name}": Rule(Right.RUN),
    "/lab/new/{draft_id}/preview/{number}": Rule(Right.RUN),
    "/lab/new/{draft_id}/schema.json": Rule(Right.RUN),
    "/lab/studies/{study_id}/recruit": Rule(Right.RUN),
    "/lab/studies/{study_id}/payments": Rule(Right.PAY, "payments_seen"),
    "/lab/studies/{study_id}/payments.csv": Rule(Right.PAY, "payments_taken"),
    "/lab/studies/{study_id}/revise": Rule(Right.RUN),
    "/lab/studies/{study_id}/revise/{draft_id}": Rule(Right.RUN),
    "/lab/studies/{study_id}/revise/{draft_id}/preview/{number}": Rule(Right.RUN),
    "/lab/studies/{study_id}/analysis/{who}/report.zip": Rule(Right.TAKE, "report_taken"),
    "/lab/studies/{study_id}/analysis/{who}/{name:path}.csv": Rule(Right.TAKE, "report_taken"),
    "/lab/studies/{study_id}/analysis/{who}/{name:path}.json": Rule(Right.TAKE, "report_taken"),
    "/lab/studies/{study_id}/robot-runs/{run_id}.mcap": Rule(Right.TAKE, "recording_taken"),
    "/lab/studies/{study_id}/voices/{response_id}.webm": Rule(Right.TAKE, "voice_heard"),
    "/lab/studies/{study_id}/people/{code}/learnt.csv": Rule(Right.TAKE),
    "/lab/studies/{study_id}/paths/{environment}-{pair}.csv": Rule(Right.TAKE),
    "/lab/studies/{study_id}/coding/{item}": Rule(Right.CODE),
    "/lab/studies/{study_id}/coding/{item}/differences": Rule(Right.CODE),
    "/lab/studies/{study_id}/coding/{item}/codings.csv": Rule(Right.TAKE),
    "/lab/studies/{study_id}/protocol.yaml": Rule(Right.TAKE),  # may hold the completion code, which is worth money
    "/lab/settings": Rule(Right.MANAGE),
    "/lab/settings/setups/{name}/setup.zip": Rule(Right.EQUIP, "setup_taken"),
    "/lab/audit": Rule(Right.MANAGE),
    "/lab/recordings/{draft_id}": Rule(Right.ANALYSE),
    "/api/lab/recordings/{draft_id}": Rule(Right.ANALYSE),
    "/lab/recordings/{draft_id}/videos/{name:path}": Rule(Right.ANALYSE),
    "/lab/jobs/new": Rule(Right.ANALYSE),
    "/lab/jobs/new/{kind_name}": Rule(Right.ANALYSE),
    "/lab/artefacts/{artefact_id}/upkeep": Rule(Right.TIDY),
    "/lab/artefacts/{artefact_id}/content": Rule(Right.TAKE, "artefact_taken"),
    "/lab/policies/{artefact_id}/policy.zip": Rule(Right.TAKE, "artefact_taken"),
    "/lab/policies/{artefact_id}/policy.onnx": Rule(Right.TAKE, "artefact_taken"),
    "/lab/policies/{artefact_id}/bundle.zip": Rule(Right.TAKE, "artefact_taken"),
}


def rule_of(method: str, route: str) -> Rule | None:
    """What a request needs; `route` is the pattern, as `/lab/studies/{study_id}`. None: nobody may."""
    if method in ("GET", "HEAD", "OPTIONS"):
        return SHOWING.get(route, LOOKING)
    return CHANGING.get(route)
