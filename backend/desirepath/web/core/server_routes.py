"""Routes about the server itself: where `/` leads, how it is, what a monitoring system reads."""

from __future__ import annotations

import hmac

from fastapi import APIRouter, Request
from prometheus_client import CONTENT_TYPE_LATEST
from starlette.responses import RedirectResponse, Response

from desirepath.study.refusals import Refused
from desirepath.web.core.addresses import is_from_here
from desirepath.web.core.dependencies import services_of
from desirepath.web.core.health import CODES, Health, health_of
from desirepath.web.core.lab_frame import lab_page
from desirepath.web.core.media import PAGE
from desirepath.web.core.throttle import TOKENS_PER_ADDRESS, count, network_of

router = APIRouter()


@router.get("/", include_in_schema=False)
def home() -> Response:
    return RedirectResponse("/lab/studies", status_code=303)


@router.get("/health", tags=["server"], response_model=Health, responses={200: {"content": {PAGE: {}}}})
def health(request: Request, response: Response, prepared: bool = False) -> Health | Response:
    """For load balancers and containers, and as a page for browsers. 507: the disk is full, 503: the database does
    not answer; in both no answer can be stored. What else is wrong stands in `problems` and stops nobody. With
    `prepared` also 503 while what the first visitors would wait for is being loaded: whoever replaces a running
    server asks so before it sends them here."""
    found = health_of(services_of(request), prepared=prepared)
    response.status_code = CODES.get(found.status, 200)
    if PAGE in request.headers.get("accept", ""):
        return lab_page(request, "lab/health.html", status=response.status_code, health=found, sign_in=None)
    return found


@router.get("/metrics", include_in_schema=False)
def metrics(request: Request) -> Response:
    """403 for everybody else, 429 for who tries many tokens."""
    services = services_of(request)
    tries = not is_from_here(request) and "authorization" in request.headers
    if tries and not count(request, TOKENS_PER_ADDRESS, "metrics", network_of(request)):
        raise Refused(429, "too_many", "Too many requests from here; wait a minute and try again.")
    if not (is_from_here(request) or _has_token(request, services.settings.metrics_token)):
        message = "Metrics are for this machine, or for who sends DESIREPATH_METRICS_TOKEN as a bearer token."
        raise Refused(403, "metrics_from_elsewhere", message)
    return Response(services.monitoring.text(services.settings, services.database), media_type=CONTENT_TYPE_LATEST)


def _has_token(request: Request, token: str) -> bool:
    sent = request.headers.get("authorization", "").encode()
    return bool(token) and hmac.compare_digest(sent, f"Bearer {token}".encode())
