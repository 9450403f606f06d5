"""How much one browser or address may ask for, and the largest body. What is refused, routes decide.

The limits keep a flood from filling the event log, a study or the memory. Whole classes behind one address fit in.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable

from fastapi import Request
from limits import RateLimitItem, parse
from limits.storage import MemoryStorage
from limits.strategies import MovingWindowRateLimiter, RateLimiter, SlidingWindowCounterRateLimiter
from starlette.exceptions import HTTPException

from desirepath.store.models import utc_now
from desirepath.web.core.dependencies import services_of
from desirepath.web.replicas.shared_limits import SharedCounts

REFUSALS_PER_ADDRESS = parse("60 per 1 minute")  # ours; refusals that no session or join form is known for
JOINS_PER_ADDRESS = parse("120 per 1 minute")  # ours; a lecture hall behind one address opens the link at once
EVENTS_PER_SESSION = parse("300 per 1 minute")  # ours; a page notices a few things a minute
CHANGES_PER_SESSION = parse("1200 per 1 minute")  # ours; bots that wait for nothing send some hundred
TOKENS_PER_ADDRESS = parse("120 per 1 minute")  # ours; of /metrics, right ones too: somebody may ask every second
PROBLEMS_PER_SESSION = parse("10 per 1 hour")  # ours; reports in a participant's own words
REQUESTS_PER_ROBOT = parse("1200 per 1 minute")  # ours; it says 5 times a second where it is
RECORDINGS_PER_ROBOT = parse("60 per 1 hour")  # ours
LARGEST_RECORDING = 32 * 1024 * 1024  # bytes (ours); a run of five minutes with a lidar of 360 beams has two MB
LARGEST_BODY = 2 * 1024 * 1024  # bytes (ours), for who is signed in; a protocol with its texts has some ten kB
LARGEST_STREAM = 2 * 1024**3  # bytes (ours), of a file that goes to the disk as it comes; larger: on the command line
LARGEST_OPEN_BODY = 256 * 1024  # bytes (ours), for everybody; the longest answers have a few kB


def limiter_for(counts: SharedCounts | None) -> RateLimiter:
    """Counts that all processes share, else in memory: a restart forgives then."""
    return MovingWindowRateLimiter(MemoryStorage()) if counts is None else SlidingWindowCounterRateLimiter(counts)


def address_of(request: Request) -> str:
    """Where the request comes from, as uvicorn knows it (a trusted proxy's word counts)."""
    found = request.client.host if request.client else "unknown"
    return found.removeprefix("::ffff:")  # IPv4 at a server that listens on `::`


def network_of(request: Request) -> str:
    """What is counted per address: of IPv6 the first 64 bits, whose other half everybody may choose anew each time."""
    address = address_of(request)
    try:
        return str(ipaddress.IPv6Network((address.partition("%")[0], 64), strict=False))
    except ValueError:
        return address


def count(request: Request, limit: RateLimitItem, *key: str) -> bool:
    """Count one request; False where it is one too many."""
    return services_of(request).limiter.hit(limit, *key)


def is_exhausted(request: Request, limit: RateLimitItem, *key: str) -> bool:
    """Whether the next request would be one too many; counts nothing."""
    return not services_of(request).limiter.test(limit, *key)


def seconds_to_wait(request: Request, windows: Iterable[tuple[RateLimitItem, str]]) -> int | None:
    """Count one request towards each of these; where it is one too many for one, the seconds until it is not."""
    for limit, key in windows:
        if not count(request, limit, key):
            reset_at = services_of(request).limiter.get_window_stats(limit, key).reset_time
            return max(1, round(reset_at - utc_now().timestamp()))
    return None


def wait_in_words(seconds: int) -> str:
    """Minutes, from two hours on hours; the same in every language."""
    return f"{-(-seconds // 60)} min" if seconds < 7_200 else f"{-(-seconds // 3_600)} h"


class TooLarge(HTTPException):
    """A body of more than `limit` bytes."""

    def __init__(self, limit: int) -> None:
        super().__init__(413, f"The body is larger than {limit} bytes.")


def is_declared_too_large(request: Request, limit: int) -> bool:
    """Whether the request itself says that its body is too large; it is refused before a byte of it is read."""
    declared = request.headers.get("content-length", "0")
    return not declared.isdecimal() or int(declared) > limit
