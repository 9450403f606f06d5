"""What moved a robot in a trial that is replayed: the scores that its participant was shown, or, where somebody asks,
those of a policy along the same way. Pages are `answer_replay.py`'s, scores `desirepath.explain`'s.

Trajectories of query sets do not say which policy rolled them out, so who asks chooses one of the same setup; the
trial's own stands first where it is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fastapi import Request
from sqlalchemy.orm import Session as DatabaseSession

from desirepath.explain.flow_words import ExplanationWords
from desirepath.explain.methods import COMMANDS, AttributionError, Method, check_method
from desirepath.explain.shown_explanation import ShownExplanation
from desirepath.simulation.trajectory import Trajectory
from desirepath.store.artefacts import ArtefactStore
from desirepath.store.models import Artefact, Trial
from desirepath.study.personalising.live_rollouts import driving, network_in
from desirepath.web.analyst.chosen_policies import choices_of
from desirepath.web.core.catalogues import Catalogue
from desirepath.web.core.lab_frame import LabRefusal, rights_in
from desirepath.web.core.moment_charts import MomentChart, lanes_of, moment_chart

METHOD: Method = "saliency"  # the one that chapter 8 shows to people
POLICY = "policy"  # kind of artefact; a conditioned one would need weights


@dataclass(frozen=True)
class Reasons:
    """What moved the robots of a trial. policy: by whose scores, None: as they were shown to the participant;
    explained: of each trajectory, for the stage; charts: each one's scores over time."""

    policy: Artefact | None
    command: str
    explained: tuple[ShownExplanation, ...]
    charts: tuple[MomentChart, ...]


def policies_for(s: DatabaseSession, request: Request, trial: Trial, setup: str) -> list[Artefact]:
    """The policies by which this trial can be explained, those that rolled it out first."""
    own = {value for value in (trial.arms or {}).values() if isinstance(value, str)}
    there = [choice for choice in choices_of(s, rights_in(request)) if choice.kind == POLICY and choice.setup == setup]
    return sorted(there, key=lambda one: one.id not in own)


def reasons_of(
    files: ArtefactStore,
    t: Catalogue,
    trajectories: Sequence[Trajectory],
    policies: Sequence[Artefact],
    *,
    asked: str,
    command: str,
    shown: ShownExplanation | None,
) -> Reasons | None:
    """asked: a policy's id; "": none, then what was shown, if anything. Raises LabRefusal for a policy that is none of
    those, or a command that there is not."""
    if not asked:
        if shown is None:
            return None
        charts = tuple(_chart(t, shown.things, shown.scores, trajectory) for trajectory in trajectories)
        return Reasons(None, COMMANDS[0], (shown,) * len(trajectories), charts)
    policy = next((choice for choice in policies if choice.id == asked), None)
    if policy is None:
        raise LabRefusal(404, "no_artefact")
    try:
        _, wanted = check_method(METHOD, command or COMMANDS[0])
    except AttributionError:
        raise LabRefusal(404, "no_figure") from None
    from desirepath.web.core.explained_policy import explain_along

    explained, charts_of = [], []
    for trajectory in trajectories:
        acting = network_in(driving(files, policy.id), trajectory.scene)
        things, scores, seen = explain_along(acting, trajectory, method=METHOD, command=wanted)
        explained.append(seen)
        charts_of.append(_chart(t, things, scores, trajectory))
    return Reasons(policy, wanted, tuple(explained), tuple(charts_of))


def _chart(t: Catalogue, things: Sequence[str], scores: Sequence[Sequence[float]], of: Trajectory) -> MomentChart:
    words = ExplanationWords(things=t.table("explanation.things"))
    lanes = lanes_of(things, scores, {name: words.thing(name) for name in things})
    return moment_chart(lanes, of.dt, title=t("explanation.over_time"), time_label=t("explanation.words.time"))
