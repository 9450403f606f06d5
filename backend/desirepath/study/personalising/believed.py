"""What a participant's own answers let believe of their preference, in numbers that can be told in plain words.

Words are the catalogues', the page `kinds/meet_your_robot.py`'s. What experimenters watch meanwhile is `learnt.py`'s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from sqlalchemy.orm import Session as DatabaseSession

from desirepath.store.artefacts import ArtefactStore
from desirepath.store.job_results import AlignResult, Learned
from desirepath.store.models import Artefact, Job, Session
from desirepath.study.personalising import alignment_jobs, next_query

SOMETHING_ELSE = 0.5  # as in `preferences/free_posterior.py`, which no page loads
SAID_FROM = 0.8  # ours: what is less probable is no sentence
TOLD = 2  # ours: more measures than that nobody keeps in mind
SEEN_IN = 2 / 3  # ours: of the answers; what fewer of them show is not told


@dataclass(frozen=True)
class Beyond:
    """That answers are about something that is none of the nine objectives: sure: how probably; words: named measures
    that show it best, at most two, each with whether more or less of it is preferred, and in how many of `answers` the
    chosen trajectory had it; none where no measure shows it.
    """

    sure: float
    words: list[tuple[str, Literal["more", "less"], int]]
    answers: int


@dataclass(frozen=True)
class Believed:
    """weights: preference weights above 0, by objective. foremost: what most probably matters most, with that
    probability `sure`; rather_than: what matters least of what does not exclude it; rather_sure: how probable it is
    that the nine objectives describe this person and that the first matters more. answers: from how many. beyond: where
    the nine objectives do not describe them, so that weights are only what comes closest. statement: which one this
    person is told of it, None where their answers are not predicted better than chance, or nothing is probable enough.
    closest: the robot that is shown goes by no weights, so that these are only what comes closest to it.
    """

    weights: dict[str, float]
    foremost: str
    sure: float
    rather_than: str
    rather_sure: float
    answers: int
    beyond: Beyond | None = None
    statement: Literal["rather", "beyond"] | None = None
    closest: bool = False

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def find_belief(
    s: DatabaseSession, files: ArtefactStore, session: Session, shown: Job | None = None
) -> Believed | None:
    """What the session's answers say; None where nothing was answered that teaches. shown: the alignment whose policy
    was shown; its own weights count where it has some."""
    answers = next_query.answers_of(s, session)
    if not answers:
        return None
    from desirepath.learning.preferences.objectives import objectives_of

    posterior = next_query.posterior_of(s, files, session)
    objectives = objectives_of(posterior.setup)
    names = [objective.name for objective in objectives]
    foremost = int(posterior.foremost().argmax())
    importance = posterior.shares()
    others = [k for k in range(len(names)) if k != foremost and names[k] != objectives[foremost].opposite]
    least = min(others, key=lambda k: float(importance[k]))
    more = posterior.weights[:, foremost] > posterior.weights[:, least]
    check = alignment_jobs.check_of(s, session) or {}
    aligned = shown.result_as(AlignResult) if shown is not None else None
    beyond = beyond_nine(check, aligned is not None and aligned.free_form)
    rather_sure = (1 - float(check.get("something_else") or 0.0)) * float(posterior.masses() @ more)
    statement: Literal["rather", "beyond"] | None = None
    if check.get("better_than_chance"):
        statement = "rather" if rather_sure >= SAID_FROM else None
        if beyond is not None:
            statement = "beyond" if beyond.words else None
    of_shown = _weights_of(s, shown)
    weights = of_shown
    if weights is None:
        weights = {name: float(w) for name, w in zip(names, posterior.mean_weights(), strict=True)}
    return Believed(
        weights={name: round(weight, 3) for name, weight in weights.items() if weight > 0},
        foremost=names[foremost],
        sure=round(float(posterior.foremost()[foremost]), 3),
        rather_than=names[least],
        rather_sure=round(rather_sure, 3),
        answers=len(answers),
        beyond=beyond,
        statement=statement,
        closest=shown is not None and of_shown is None,
    )


def beyond_nine(check: Mapping[str, Any], free_form: bool) -> Beyond | None:
    """What the predictive check says where a free-form policy is shown, or where something else is more probable."""
    words, agreeing = check.get("words") or {}, check.get("agreeing") or {}
    sure = float(check.get("something_else") or 0.0)
    if not words or not (free_form or sure >= SOMETHING_ELSE):
        return None
    answers = int(check.get("answers") or 0)
    most = [name for name in sorted(words, key=lambda name: -abs(words[name])) if agreeing[name] >= SEEN_IN * answers]
    in_words: list[tuple[str, Literal["more", "less"], int]] = [
        (name, "more" if words[name] > 0 else "less", int(agreeing[name])) for name in most[:TOLD]
    ]
    return Beyond(round(sure, 3), in_words, answers)


def _weights_of(s: DatabaseSession, shown: Job | None) -> dict[str, float] | None:
    """The weights that the shown policy is conditioned on, None where it is no conditioned one."""
    learned = shown.result_as(Learned) if shown is not None else None
    artefact = s.get(Artefact, learned.policy) if learned is not None else None
    config = (artefact.card.get("config") or {}) if artefact is not None else {}
    weights = config.get("preference_weights")
    return {str(name): float(weight) for name, weight in weights.items()} if weights else None
