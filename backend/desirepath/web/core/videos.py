"""Videos that are shown in the stage's place: which trajectories have one, and their bytes by ranges, as players ask.

A file is kept as an artefact; it goes out as it came in, with the type that was found in it, whatever it is called.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

from fastapi import Request
from sqlalchemy.orm import Session as DatabaseSession
from starlette.responses import Response, StreamingResponse

from desirepath.simulation.recorded import Video
from desirepath.store.artefacts import ArtefactStore, load_trajectory
from desirepath.store.models import TrajectoryRow

ANSWERS: dict[int | str, dict[str, Any]] = {200: {"content": {"video/mp4": {}, "video/webm": {}}}}
"""`responses` of a route that sends a video."""
PIECE = 512 * 1024  # bytes that are read at a time
RANGE = re.compile(r"bytes=(\d{0,12})-(\d{0,12})")


def video_of(s: DatabaseSession, files: ArtefactStore, trajectory_id: str) -> Video | None:
    """The video of a stored trajectory, None where the stage shows it."""
    row = s.get(TrajectoryRow, trajectory_id)
    recorded = row is not None and (row.made_by or "").startswith("recording:")
    return _video_in(files, trajectory_id) if recorded else None


@lru_cache(maxsize=4_096)  # a trajectory never changes
def _video_in(files: ArtefactStore, trajectory_id: str) -> Video | None:
    recorded = load_trajectory(files, trajectory_id).recorded
    return recorded.video if recorded is not None else None


def video_response(request: Request, files: ArtefactStore, video: Video) -> Response:
    """The range that is asked for (206), or all of it; 416 for a range that is none. Raises ArtefactError if the file
    is gone."""
    size = files.size(video.sha256)
    first, last = 0, size - 1
    headers = {"Accept-Ranges": "bytes", "Content-Disposition": "inline"}
    asked = request.headers.get("Range")
    if asked is not None:
        found = RANGE.fullmatch(asked.strip())
        if found is None or not (found[1] or found[2]):
            return Response(status_code=416, headers={**headers, "Content-Range": f"bytes */{size}"})
        if found[1]:
            first, last = int(found[1]), min(int(found[2]) if found[2] else size - 1, size - 1)
        else:
            first = max(0, size - int(found[2]))
        if first > last:
            return Response(status_code=416, headers={**headers, "Content-Range": f"bytes */{size}"})
        headers["Content-Range"] = f"bytes {first}-{last}/{size}"

    def pieces() -> Iterator[bytes]:
        for at in range(first, last + 1, PIECE):
            yield files.part(video.sha256, at, min(at + PIECE, last + 1))

    headers["Content-Length"] = str(last - first + 1)
    return StreamingResponse(pieces(), 200 if asked is None else 206, headers, media_type=video.media)
