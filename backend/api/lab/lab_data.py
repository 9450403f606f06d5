"""What signed-in programs are told in JSON: a study's people as they are now, a job. Pages are the templates'."""

from __future__ import annotations

from typing import Any

from backend.api.core.contract import Reply


class PersonNow(Reply):
    """One participant as the tab *Now* shows them."""

    code: str
    simulated: bool
    excluded: bool
    presence: str
    stage: str | None
    step: str | None
    phase: str | None
    progress: float
    answers: int
    restarts: int
    flags: list[str]
    pilot: bool
    trial_s: float | None
    last_seen_at: Any


class StageNow(Reply):
    """How many are at a stage of the protocol, and how many were lost there."""

    stage: str
    under_way: int
    dropped: int


class Monitor(Reply):
    """A study as it stands now."""

    study: str
    state: str
    people: list[PersonNow]
    stages: list[StageNow]
    median_trial_s: float | None
    orders: list[dict[str, Any]]


class JobData(Reply):
    """A job with its curves: (step, value) by name."""

    job: str
    kind: str
    state: str
    progress: float
    message: str | None
    error: str | None
    params: dict[str, Any]
    result: dict[str, Any] | None
    curves: dict[str, list[tuple[int, float]]]
