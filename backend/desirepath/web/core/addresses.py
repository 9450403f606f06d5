"""Under which address people reach this server: what is set, else what a browser asked for where it can be ours.

A request's `Host` is whatever its sender wrote. It may name the server back to that sender, but a link that is handed
on carries no name that could be somebody else's.
"""

from __future__ import annotations

import ipaddress
import re
import socket

from fastapi import Request
from starlette.requests import HTTPConnection

from desirepath.settings import in_url

_PLAIN_ORIGIN = re.compile(r"https?://[A-Za-z0-9.-]+(:[0-9]+)?")  # the header's grammar has no IPv6 addresses either
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")
STRICT_TRANSPORT = ("Strict-Transport-Security", "max-age=31536000")
"""A year; nothing about other names of the domain, which are not ours to promise for."""


def insists_on_tls(request: HTTPConnection) -> bool:
    """Whether the browser is told to come by TLS only: where it did, and not at localhost, whose other ports serve
    other things."""
    name = request.url.hostname or ""
    return request.url.scheme == "https" and name not in LOOPBACK_NAMES and not name.endswith(".localhost")


def policy_source(origin: str) -> str:
    """An origin in a Content-Security-Policy, whose grammar has no IPv6 addresses: for those any host on that port."""
    scheme, bracket, rest = origin.partition("://[")
    return f"{scheme}://*{rest.partition(']')[2]}" if bracket else origin


def permissions(*, speaks: bool = False, room: str | None = None) -> str:
    """A page's Permissions-Policy: no camera; a microphone where it `speaks`; a headset for itself, which tells whether
    there is one, and for the stage at the origin `room` inside it, which shows the room in it."""
    named = room is not None and _PLAIN_ORIGIN.fullmatch(room)
    shown = "*" if room is not None and not named else f'(self "{room}")' if room else "(self)"
    microphone = "(self)" if speaks else "()"
    return f"camera=(), microphone={microphone}, geolocation=(), xr-spatial-tracking={shown}"


def is_from_here(request: Request) -> bool:
    """Whether this machine asks, not somebody for whom a trusted proxy on it does."""
    try:
        return request.client is not None and ipaddress.ip_address(request.client.host).is_loopback
    except ValueError:
        return False


def safe_base_url(request: Request) -> str:
    """The address that the browser asked for, where it is a name of this machine or an address in a private network;
    else the machine's own."""
    asked = str(request.base_url)
    host, port = request.scope.get("server") or (LOOPBACK_NAMES[1], None)
    if _is_ours(request.base_url.hostname or "", host):
        return asked
    return f"{request.url.scheme}://{in_url(host)}:{port}" if port else f"{request.url.scheme}://{in_url(host)}"


def _is_ours(name: str, listening: str) -> bool:
    """Whether a host name can only be this machine: its own names, the address that was connected to, a private one."""
    name = name.lower().rstrip(".")
    own = socket.gethostname().lower()
    if name in {*LOOPBACK_NAMES, listening.lower(), own, own.partition(".")[0], f"{own.partition('.')[0]}.local"}:
        return True
    try:
        return ipaddress.ip_address(name).is_private
    except ValueError:
        return False
