"""Recruiting platforms: under which names they send a person's id, what an id looks like, what is none. Who joins with
it is `joining.py`'s.

Whatever comes from outside as an id is read here, and lists of ids are written of what `is_id` only.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from desirepath.study.refusals import Refused

_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
_IN_BRACES = re.compile(r"[{%$\[<(]++[^{}%$\[\]<>()]{0,80}[}%\])>]+")  # {{%NAME%}}, %NAME%, ${NAME}, [NAME], ...
PREVIEW = "ASSIGNMENT_ID_NOT_AVAILABLE"  # what MTurk sends while somebody only looks at a task


@dataclass(frozen=True)
class Platform:
    """person: parameters that may hold the person's id; further: parameter -> what it tells; address: what is put
    behind a study's link there, with the placeholders that the platform fills in."""

    name: str
    title: str
    person: tuple[str, ...]
    further: Mapping[str, str]
    address: str


PLATFORMS = (
    Platform(
        "prolific",
        "Prolific",
        ("PROLIFIC_PID",),
        {"STUDY_ID": "study", "SESSION_ID": "session"},
        "?PROLIFIC_PID={{%PROLIFIC_PID%}}&STUDY_ID={{%STUDY_ID%}}&SESSION_ID={{%SESSION_ID%}}",
    ),
    Platform("sona", "SONA", ("survey_code", "id"), {}, "?survey_code=%SURVEY_CODE%"),
    Platform(
        "mturk",
        "Amazon Mechanical Turk",
        ("workerId",),
        {"assignmentId": "session", "hitId": "study"},
        "?workerId=${workerId}&assignmentId=${assignmentId}&hitId=${hitId}",
    ),
)
TITLES = {platform.name: platform.title for platform in PLATFORMS}
PARAMETERS = {name.lower(): name for platform in PLATFORMS for name in (*platform.person, *platform.further)}
"""Every parameter, small letters -> as its platform writes it."""


@dataclass(frozen=True)
class Sender:
    """Who sent somebody. recruiting: {"platform", "external_id", ...}, None: nobody, or nobody that was named;
    unfilled: parameters whose placeholder the platform never filled in; preview: only looked at, no task was taken."""

    recruiting: Mapping[str, str] | None
    unfilled: Sequence[str] = ()
    preview: bool = False


def is_id(value: str) -> bool:
    """Whether this is how platforms write an id."""
    return _ID.fullmatch(value) is not None


def by_parameter(sent: Mapping[str, str | None]) -> dict[str, str]:
    """Those of the parameters that are given, by the names that platforms write, without spaces around them."""
    named = {PARAMETERS.get(name.lower(), ""): (value or "").strip() for name, value in sent.items()}
    return {name: value for name, value in named.items() if name and value}


def sender_of(sent: Mapping[str, str | None]) -> Sender:
    """Read what a link or a form brought. Raises Refused 422 `bad_id` for what no platform sends."""
    parameters = by_parameter(sent)
    if PREVIEW in parameters.values():
        return Sender(None, preview=True)
    unfilled = tuple(name for name, value in parameters.items() if _is_placeholder(value))
    for name in unfilled:
        del parameters[name]
    for name, value in parameters.items():
        if not is_id(value):
            wanted = "must be 1 to 64 letters, digits, _ or -, as platforms write their ids"
            raise Refused(422, "bad_id", wanted, field=name, value=value[:100])
    for platform in PLATFORMS:
        external_id = next((parameters[name] for name in platform.person if name in parameters), None)
        if external_id is not None:
            further = {key: parameters[name] for name, key in platform.further.items() if name in parameters}
            return Sender({"platform": platform.name, "external_id": external_id, **further}, unfilled)
    return Sender(None, unfilled)


def _is_placeholder(value: str) -> bool:
    """Braces of whatever form around a name, or a parameter's own name."""
    return _IN_BRACES.fullmatch(value) is not None or value.lower() in PARAMETERS.keys() - {"id"}
