"""Prolific's interface for researchers: what is asked of it, and how it is asked (docs.prolific.com, version 1).

A `Call` can be shown before it is sent. The token goes into a header and nowhere else: no text, log or error has it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import httpx

from desirepath.settings import Settings
from desirepath.study.session.platforms import is_id
from desirepath.web.core.openid import is_safe

PATIENCE_S = 20.0
LARGEST = 2 * 1024 * 1024  # bytes of an answer (ours); a page of 100 submissions has about 50 kB
PAGE, MOST_PAGES = 100, 100
MOST_APPROVED = 1_000  # of one call, as Prolific recommends
MOST_PAID = 200  # of one bulk payment, as Prolific has it
LONGEST_REASON = 300
AWAITING = "AWAITING REVIEW"


class ProlificError(ValueError):
    """What cannot be asked, or what Prolific says to it; without the token."""


@dataclass(frozen=True)
class Call:
    """One request. path: behind the address of the interface."""

    method: str
    path: str
    body: dict[str, Any] | None = None

    def as_dict(self, base: str) -> dict[str, Any]:
        return {"method": self.method, "url": f"{base}{self.path}", "body": self.body}


def _checked(name: str, value: str) -> str:
    if not is_id(value):
        raise ProlificError(f"{name} = {value[:80]!r}: must be 1 to 64 letters, digits, _ or -")
    return value


def study_call(study: str) -> Call:
    """What is known of a study there: status, places."""
    return Call("GET", f"/api/v1/studies/{_checked('study', study)}/")


def places_call(study: str, places: int) -> Call:
    """Take in that many people in all."""
    return Call("PATCH", study_call(study).path, {"total_available_places": places})


def submissions_call(study: str, page: int) -> Call:
    """A page of who took part there: submissions with participant and status."""
    return Call("GET", f"/api/v1/submissions/?study={_checked('study', study)}&page={page}&page_size={PAGE}")


def approve_calls(submissions: Sequence[str]) -> list[Call]:
    """Approve these submissions, in as many calls as it takes."""
    named = [_checked("submission", one) for one in submissions]
    batches = (named[k : k + MOST_APPROVED] for k in range(0, len(named), MOST_APPROVED))
    return [Call("POST", "/api/v1/submissions/bulk-approve/", {"submission_ids": batch}) for batch in batches]


def bonus_calls(study: str, participants: Sequence[str], amount: str) -> list[Call]:
    """Set up a bonus for each; nothing is paid by that."""
    named = [_checked("participant", one) for one in participants]
    batches = (named[k : k + MOST_PAID] for k in range(0, len(named), MOST_PAID))
    return [
        Call(
            "POST",
            "/api/v1/submissions/bonus-payments/",
            {"study_id": _checked("study", study), "csv_bonuses": "\n".join(f"{one},{amount}" for one in batch)},
        )
        for batch in batches
    ]


def pay_call(bulk: str) -> Call:
    """Pay what was set up. Prolific pays again for each such call."""
    return Call("POST", f"/api/v1/bulk-bonus-payments/{_checked('bulk payment', bulk)}/pay/", {})


class Prolific:
    """The interface with a token. Raises ProlificError where the settings make none."""

    def __init__(self, settings: Settings) -> None:
        self.base = prolific_address(settings)
        token = settings.prolific_secret
        if not token:
            raise ProlificError(
                "no token: set DESIREPATH_PROLIFIC_TOKEN_FILE to a file that holds it, or DESIREPATH_PROLIFIC_TOKEN"
            )
        if not token.isascii() or not token.isprintable() or " " in token:
            raise ProlificError("the token has characters that no token has; copy it again from Prolific")
        self._token = token

    def send(self, call: Call) -> Any:
        """What is answered, as JSON. Raises ProlificError."""
        headers = {"Authorization": f"Token {self._token}", "Accept": "application/json"}
        where = f"{call.method} {call.path.partition('?')[0]}"
        try:
            with (
                httpx.Client(timeout=PATIENCE_S, follow_redirects=False, trust_env=False) as client,
                client.stream(call.method, f"{self.base}{call.path}", headers=headers, json=call.body) as answer,
            ):
                body = b""
                for part in answer.iter_bytes():
                    body += part
                    if len(body) > LARGEST:
                        raise ProlificError(f"{where}: answered with more than {LARGEST} bytes")
                status = answer.status_code
        except httpx.HTTPError as problem:
            raise ProlificError(f"{where}: {type(problem).__name__}; whether it came through is not known") from None
        if not 200 <= status < 300:
            raise ProlificError(f"{where}: answered {status}{self._reason(body)}")
        try:
            return json.loads(body) if body.strip() else {}
        except (ValueError, RecursionError):
            raise ProlificError(f"{where}: answered with no JSON") from None

    def _reason(self, body: bytes) -> str:
        """What the answer says, short, on one line, without the token in case it is repeated there."""
        said = " ".join(body[: 4 * LONGEST_REASON].decode("utf-8", "replace").split()).replace(self._token, "***")
        shown = "".join(letter for letter in said if letter.isprintable())[:LONGEST_REASON]
        return f": {shown}" if shown else ""

    def study(self, study: str) -> dict[str, Any]:
        return _object(self.send(study_call(study)), "a study")

    def submissions(self, study: str) -> Iterator[dict[str, Any]]:
        """All of the study's, page by page."""
        for page in range(1, MOST_PAGES + 1):
            found = _object(self.send(submissions_call(study, page)), "submissions").get("results")
            if not isinstance(found, list) or not all(isinstance(one, dict) for one in found):
                raise ProlificError("the answer has no list `results` of submissions")
            yield from found
            if len(found) < PAGE:
                return
        raise ProlificError(f"more than {MOST_PAGES * PAGE} submissions")


def prolific_address(settings: Settings) -> str:
    """Where the interface is, without a trailing slash. Raises ProlificError for what others on the way could read."""
    base = settings.prolific_url.rstrip("/")
    if not is_safe(base):
        raise ProlificError(f"prolific_url = {base!r}: must begin with https://, or be this machine itself")
    return base


def _object(found: Any, what: str) -> dict[str, Any]:
    if not isinstance(found, dict):
        raise ProlificError(f"the answer is no JSON object about {what}")
    return found
