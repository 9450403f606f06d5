"""Whether there is room for what people answer: asked by `/health` and by the banner of the signed-in pages.

What a full disk does to a request is the database's (`DiskFull`) and the guard's: 507, nothing stored, ask again later.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from desirepath.settings import Settings
from desirepath.store.database import MIN_FREE_BYTES

FULL_BYTES = 5 * 2**20  # ours: below this a database's log cannot grow by what a minute of many people brings


@dataclass(frozen=True)
class Room:
    """How much room is left where the data are; `state`: low below what a start asks for."""

    state: Literal["ok", "disk_low", "disk_full"]
    free_mb: int


def room_left(settings: Settings) -> Room:
    """The room on the fullest disk of those that this server writes on."""
    places = [settings.data, Path(settings.database.removeprefix("sqlite:///")).parent]
    free = min(shutil.disk_usage(place).free for place in places if place.is_dir())
    state: Literal["ok", "disk_low", "disk_full"] = (
        "ok" if free >= MIN_FREE_BYTES else "disk_low" if free >= FULL_BYTES else "disk_full"
    )
    return Room(state, free // 2**20)
