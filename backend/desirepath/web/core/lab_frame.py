"""What every signed-in page shares: its language, its frame, its refusals. No route lives here.

`lab_page(request, "lab/....html", ...)` renders a page; raise `LabRefusal(status, code)` to refuse one kindly.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from fastapi import Request
from starlette.responses import HTMLResponse, Response

from desirepath.web.core.contract import Refusal, reply_of
from desirepath.web.core.dependencies import page, route_of, services_of
from desirepath.web.core.disk import room_left
from desirepath.web.core.guides import fitting_guide
from desirepath.web.core.roles import Rights

LANGUAGES = ("en", "de")
LANGUAGE_COOKIE = "desirepath_lab_language"


@dataclass(frozen=True)
class SignInState:
    """What templates may know of the sign-in: `request.state.sign_in`."""

    name: str
    role: str
    csrf: str
    must_change_password: bool = False
    rights: Rights = field(default_factory=Rights)
    by_link: bool = False

    def may(self, right: str, study_id: str | None = None) -> bool:
        """Whether this may be done (`roles.Right`) in a study, or with what belongs to none."""
        return self.rights.may(right, study_id)


def rights_in(request: Request) -> Rights:
    """What who is signed in may do."""
    found: Rights = request.state.sign_in.rights
    return found


class LabRefusal(Exception):
    """A refusal for people: `code` is a key below `refusals` in lab.yaml, `values` fill its placeholders."""

    def __init__(self, status: int, code: str, /, **values: Any) -> None:
        self.status, self.code, self.values = status, code, values
        super().__init__(f"{status} {code}")


def lab_language(request: Request) -> str:
    """The language chosen on these pages, else the browser's first one that we have, else English."""
    chosen = request.cookies.get(LANGUAGE_COOKIE)
    if chosen in LANGUAGES:
        return chosen
    return services_of(request).texts.best(request.headers.get("Accept-Language"), LANGUAGES)


def lab_page(request: Request, template: str, *, status: int = 200, **context: Any) -> HTMLResponse:
    """Render a signed-in page; its templates have `sign_in` (None on the sign-in page), `languages` and
    `openid` (the provider, where there is one) besides."""
    context.setdefault("sign_in", getattr(request.state, "sign_in", None))
    context["openid"] = services_of(request).openid
    if context["sign_in"] is not None:
        context["guide_here"] = fitting_guide(route_of(request))
        context["room"] = room_left(services_of(request).settings)
    return page(request, template, language=lab_language(request), status=status, languages=LANGUAGES, **context)


def lab_refusal(request: Request, problem: Exception) -> Response:
    """Show a LabRefusal: a page under /lab, JSON under /api."""
    assert isinstance(problem, LabRefusal)  # noqa: S101 - registered for this class only
    values = dict(problem.values)
    t = services_of(request).texts.get(lab_language(request))
    if problem.code == "role" and t.knows(f"operating.roles.{values['role']}"):
        values["role"] = t(f"operating.roles.{values['role']}")
    if request.url.path.startswith("/api/"):
        words = f"{'lab' if t.knows(f'lab.refusals.{problem.code}') else 'analyst'}.refusals.{problem.code}"
        message = f"{t(f'{words}.title', **values)}. {t(f'{words}.text', **values)}"
        return reply_of(Refusal, {"error": {"code": problem.code, "message": message}}, problem.status)
    return lab_page(request, "lab/refusal.html", status=problem.status, code=problem.code, values=values)
