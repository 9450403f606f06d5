"""What a participant's own answers let believe of their preference, in numbers that can be told in plain words.

Words are the catalogues', the page `kinds/meet_your_robot.py`'s. What experimenters watch meanwhile is `learnt.py`'s.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from sqlalchemy.orm import Session as DatabaseSession

from backend.store.artefacts import ArtefactStore
from backend.store.models import Artefact, Job, Session
from backend.study.personalising import next_query


@dataclass(frozen=True)
class Believed:
    """weights: preference weights above 0, by objective. foremost: what most probably matters most, with that
    probability `sure`; rather_than: what matters least of what does not exclude it, and how probable it is that it
    matters less (`rather_sure`). answers: from how many.
    """

    weights: dict[str, float]
    foremost: str
    sure: float
    rather_than: str
    rather_sure: float
    answers: int

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def believed_of(
    s: DatabaseSession, files: ArtefactStore, session: Session, shown: Job | None = None
) -> Believed | None:
    """What the session's answers say; None where nothing was answered that teaches. shown: the alignment whose policy
    was shown; its own weights count where it has some."""
    answers = next_query.answers_of(s, session)
    if not answers:
        return None
    import numpy as np

    from backend.learning.preferences.objectives import NAMES, OBJECTIVES

    posterior = next_query.posterior_of(s, files, session)
    foremost = int(posterior.foremost().argmax())
    importance = posterior.shares()
    others = [k for k in range(len(NAMES)) if k != foremost and NAMES[k] != OBJECTIVES[foremost].opposite]
    least = min(others, key=lambda k: float(importance[k]))
    apart = np.sign(posterior.weights[:, foremost] - posterior.weights[:, least])  # where neither counts: even chances
    weights = _weights_of(s, shown)
    if weights is None:
        weights = {name: float(w) for name, w in zip(NAMES, posterior.mean_weights(), strict=True)}
    return Believed(
        weights={name: round(weight, 3) for name, weight in weights.items() if weight > 0},
        foremost=NAMES[foremost],
        sure=round(float(posterior.foremost()[foremost]), 3),
        rather_than=NAMES[least],
        rather_sure=round(float(np.sum(posterior.masses() * (1 + apart) / 2)), 3),
        answers=len(answers),
    )


def _weights_of(s: DatabaseSession, shown: Job | None) -> dict[str, float] | None:
    """The weights that the shown policy is conditioned on, None where it is no conditioned one."""
    policy = (shown.result or {}).get("policy") if shown is not None else None
    artefact = s.get(Artefact, str(policy)) if policy else None
    config = (artefact.card.get("config") or {}) if artefact is not None else {}
    found = config.get("preference_weights")
    return {str(name): float(weight) for name, weight in found.items()} if found else None
