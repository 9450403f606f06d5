"""What the server's clock can say of how long something took; it may have been set back meanwhile."""

from __future__ import annotations

from datetime import datetime

JITTER_S = 1.0  # ours: clocks are slewed by less while somebody watches


def elapsed_s(since: datetime, now: datetime) -> float | None:
    """Seconds since then; None where the clock was set back meanwhile, so that nobody can tell."""
    passed = (now - since).total_seconds()
    return None if passed < -JITTER_S else max(0.0, passed)
