"""What every request and answer in JSON has in common: cleaned and bounded input, one shape of refusal.

The models of single routes stand beside their routes (`participant/sent.py`, `participant/replies.py`, ...); how they
are published is `published.py`'s. What is checked before a body is parsed is `guard.py`'s.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from email.message import Message
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, model_validator
from starlette.responses import Response

from desirepath.grammar.error_words import describe_expected_json

DEEPEST = 16  # arrays and objects inside each other (ours); answers need three, flow charts and bots' scenes eight
MOST_CONTAINERS = 4_200  # arrays and objects of a body (ours); the longest stroke or walk has 4 000 points
MOST_VALUES = 21_000  # of a body, containers too (ours); the longest stroke or walk has five a point
LARGEST_EXACT = 2**53  # beyond, no browser and no spreadsheet keeps an integer
LARGEST_OBJECT = 256 * 1024  # bytes of JSON in an open object; a body has no more anyway
MOST_KEYS = 1_000  # of an open object, all levels together (ours); the longest questionnaire has some hundred items
FIRST_DAY = datetime(1970, 1, 1, tzinfo=UTC)  # a browser whose clock was never set tells this one
LAST_DAY = datetime(9999, 1, 1, tzinfo=UTC)
SHOWN = 100  # characters of a wrong value that are told back


class Sent(BaseModel):
    """A body that comes in. What it does not know is left aside: pages may be older or newer than the server."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _clean(cls, given: Any) -> Any:
        return storable(given)


class Reply(BaseModel):
    """A body that goes out."""

    model_config = ConfigDict(frozen=True)


def reply_of(model: type[BaseModel], content: object, status: int = 200) -> Response:
    """The answer of a route: checked against its model once, written as JSON from there, in the thread that made it.

    What was not set is left out. Left to FastAPI, checking is sent through a thread of its own.
    """
    checked = model.model_validate(content)
    body = checked.__pydantic_serializer__.to_json(checked, by_alias=True, exclude_unset=True)
    return Response(body, status, media_type="application/json")


def form_of(fields: Iterable[str]) -> dict[str, Any]:
    """How a form is published whose fields are read by hand, as they depend on what is asked for."""
    schema = {"type": "object", "properties": {name: {"type": "string"} for name in fields}}
    return {"requestBody": {"content": {"application/x-www-form-urlencoded": {"schema": schema}}}}


def is_json(content_type: str | None) -> bool:
    """Whether a body of that type is read as JSON: by the same means as FastAPI looks, so that both always agree."""
    sent = Message()
    sent["content-type"] = content_type or ""
    kind = sent.get_content_subtype()
    return sent.get_content_maintype() == "application" and (kind == "json" or kind.endswith("+json"))


class Trouble(Reply):
    """Why a request was refused. `field`: the path to what is wrong; `value`: what was there, if it is short."""

    code: str
    message: str
    field: str | None = None
    value: str | int | float | bool | None = None


class Refusal(Reply):
    """The body of every answer with a status of 400 or more."""

    error: Trouble


def storable(value: Any) -> Any:
    """JSON as every database and file keeps it: half characters (a cut emoji) as "?", no NUL, no NaN, no huge integer.

    Python's JSON lets them in, and a single one in the append-only log would stop all exports of its study.
    """
    if isinstance(value, str):
        return value.encode("utf-8", "replace").decode().replace("\0", "")
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > LARGEST_EXACT:
        try:
            return float(value)
        except OverflowError:
            return None
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, list):
        return [storable(inner) for inner in value]
    if isinstance(value, dict):
        return {storable(key): storable(inner) for key, inner in value.items()}
    return value


def clock_of(given: Any) -> datetime | None:
    """A browser's clock: ISO 8601 with a zone, between 1970 and 9999. Raises ValueError saying so."""
    if given is None or isinstance(given, datetime):
        return given
    wanted = f"must be a time with a zone between {FIRST_DAY.year} and {LAST_DAY.year}, as 2026-01-31T12:00:00.000Z"
    try:
        moment = datetime.fromisoformat(given) if isinstance(given, str) else None
        if moment is None or moment.tzinfo is None or not FIRST_DAY <= moment.astimezone(UTC) < LAST_DAY:
            raise ValueError(wanted)
    except (ValueError, OverflowError):
        raise ValueError(wanted) from None
    return moment


def _of_size(given: dict[str, Any]) -> dict[str, Any]:
    if (size := len(json.dumps(given, separators=(",", ":")))) > LARGEST_OBJECT:
        raise ValueError(f"has {size} bytes of JSON, at most {LARGEST_OBJECT} are taken")
    return given


def _of_few_keys(given: dict[str, Any]) -> dict[str, Any]:
    if (keys := _keys(given)) > MOST_KEYS:
        raise ValueError(f"has {keys} entries, at most {MOST_KEYS} are taken")
    return given


def _keys(given: Any) -> int:
    if isinstance(given, dict):
        return len(given) + sum(_keys(inner) for inner in given.values())
    return sum(_keys(inner) for inner in given) if isinstance(given, list) else 0


Clock = Annotated[datetime | None, BeforeValidator(clock_of)]
OpenObject = Annotated[dict[str, Any], AfterValidator(_of_size), AfterValidator(_of_few_keys)]
_NULL_IS_EMPTY = BeforeValidator(lambda given: {} if given is None else given)
MaybeObject = Annotated[OpenObject, _NULL_IS_EMPTY]
AnswerValue = Annotated[dict[str, Any], AfterValidator(_of_size), _NULL_IS_EMPTY]
"""What was answered: a history of sliders has thousands of keys. How many there may be is the kind's to say."""


def trouble_in(errors: Sequence[Any]) -> Trouble:
    """The first of Pydantic's errors in our words: field, value and what would work."""
    wrong = errors[0]
    where = [str(part) for part in wrong["loc"][1:]] or [str(part) for part in wrong["loc"]]
    if wrong["type"] == "json_invalid":
        return Trouble(code="bad_value", field="body", message="must be JSON")
    value = None if wrong["type"] == "missing" else wrong.get("input")
    shown = value[:SHOWN] if isinstance(value, str) else value
    return Trouble(
        code="bad_value",
        field=".".join(where)[:SHOWN],
        value=storable(shown) if isinstance(shown, str | int | float | bool) else None,
        message=describe_expected_json(wrong),
    )
