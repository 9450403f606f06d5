"""Which policy a robot is sent for somebody: of the run it stands ready for, or what somebody's answers taught."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import TYPE_CHECKING

from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.job_results import Learned
from desirepath.store.models import Artefact, RobotRun, Session
from desirepath.study.personalising.alignment_jobs import ready_job
from desirepath.study.personalising.believed import find_belief
from desirepath.study.personalising.live_rollouts import condition_on, load_shipped_conditioned
from desirepath.study.personalising.next_query import posterior_of
from desirepath.study.refusals import Refused

if TYPE_CHECKING:
    from desirepath.learning.policies.policy import StoredPolicy


def bundle_for(
    s: DatabaseSession, files: ArtefactStore, session: Session | None, run: RobotRun | None
) -> Callable[[], bytes]:
    """What makes the bundle: of a run, the conditioned policy of its setup, whose weights the robot hears; of somebody
    without one, the policy that was made for them where a scan is all it needs, else the conditioned one at what they
    taught. Raises Refused where they taught nothing."""
    from desirepath.learning.policies.bundles import driving_files, zipped

    if run is not None and (session is None or session.id == run.session_id):
        return partial(conditioned_bundle, run.setup)
    assert session is not None  # noqa: S101  one of the two is there
    policy = _personal(s, files, session)
    return lambda: zipped(driving_files(policy))


@lru_cache(maxsize=4)
def conditioned_bundle(setup: str) -> bytes:
    """Of the conditioned policy that comes with the setup."""
    from desirepath.learning.policies.bundles import driving_files, zipped

    return zipped(driving_files(load_shipped_conditioned(setup)))


def _personal(s: DatabaseSession, files: ArtefactStore, session: Session) -> StoredPolicy:
    from desirepath.learning.policies.bundles import BY_SCAN
    from desirepath.learning.policies.policy import read_policy

    job = ready_job(s, session)
    learned = job.result_as(Learned) if job is not None else None
    artefact = s.get(Artefact, learned.policy) if learned is not None else None
    if artefact is not None and artefact.quarantined_at is None:
        policy = read_policy(files.get(artefact.id))
        if isinstance(policy, BY_SCAN):
            return policy
    believed = find_belief(s, files, session)
    if believed is None:
        raise Refused(409, "nothing_learned", "This participant has answered nothing yet that a robot learns from.")
    return condition_on(posterior_of(s, files, session).setup, believed.weights)
