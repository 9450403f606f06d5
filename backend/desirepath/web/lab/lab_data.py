"""What signed-in programs are told in JSON: a study's people as they are now, a job. Pages are the templates'."""

from __future__ import annotations

from datetime import datetime
from functools import reduce
from operator import or_
from typing import Annotated, Any

from pydantic import GetJsonSchemaHandler, JsonValue, TypeAdapter
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from desirepath.jobs.kinds import KINDS
from desirepath.web.core.contract import Reply


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
    last_seen_at: datetime | None


class StageNow(Reply):
    """How many are at a stage of the protocol, and how many were lost there."""

    stage: str
    under_way: int
    dropped: int


class OrderNow(Reply):
    """One order of conditions with the people who got it. held: places that count when the next one is given."""

    row: int | None
    order: list[str]
    groups: list[str]
    counts: dict[str, int]
    held: int
    attrition: float | None


class Monitor(Reply):
    """A study as it stands now."""

    study: str
    state: str
    people: list[PersonNow]
    stages: list[StageNow]
    median_trial_s: float | None
    orders: list[OrderNow]


class _AsParams:
    """Published as the parameters of all kinds of job; stored ones of older versions are told as they were asked."""

    @classmethod
    def __get_pydantic_json_schema__(cls, _: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        asked: Any = reduce(or_, (variant for kind in KINDS.values() for variant in kind.variants.values()))
        return {"anyOf": [handler(TypeAdapter(asked).core_schema), {"type": "object", "additionalProperties": True}]}


class AttemptData(Reply):
    """One time that a worker took a job up. seconds: how long, null while it is at work. outcome: `running`,
    `succeeded`, `failed`, `cancelled`, `crashed`, `again` or `lost` (`JobAttempt`)."""

    machine: str
    worker: str
    began_at: str
    seconds: float | None
    outcome: str


class JobData(Reply):
    """A job with its curves: (step, value) by name. result: what its kind found, as its card says it. attempts: who
    worked on it, first one first."""

    job: str
    kind: str
    state: str
    progress: float
    message: str | None
    error: str | None
    params: Annotated[dict[str, JsonValue], _AsParams]
    result: dict[str, JsonValue] | None
    attempts: list[AttemptData]
    curves: dict[str, list[tuple[int, float]]]
