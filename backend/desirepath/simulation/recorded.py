"""What is known of a trajectory that no engine made: where it was recorded, and what of it was."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

PARTS = ("poses", "heading", "people", "obstacles", "goal", "lidar", "observations", "actions", "rewards", "video")
"""What a recording may have; what it has not is absent from the trajectory, never made up."""


class NotRecordedError(ValueError):
    """Something needs what was not recorded; names the recording and what is missing."""


@dataclass(frozen=True)
class Video:
    """A film of a run, which people watch in the stage's place. sha256: of its bytes, by which it is stored."""

    sha256: str
    media: str
    bytes: int
    duration_s: float


@dataclass(frozen=True)
class Recorded:
    """file: the name of the file; sha256: of its bytes; run: which of its runs. has: which of PARTS were recorded.
    how: how what was recorded became steps of 0.2 s in a scene, in sentences. video: where there is one; without poses
    those of the trajectory are NaN.
    """

    file: str
    format: str
    sha256: str
    run: str
    has: tuple[str, ...]
    how: tuple[str, ...] = ()
    video: Video | None = None

    def __post_init__(self) -> None:
        unknown = [part for part in self.has if part not in PARTS]
        if unknown:
            raise ValueError(f"recorded.has = {unknown[0]!r}: must be of {', '.join(PARTS)}")

    @property
    def absent(self) -> tuple[str, ...]:
        """What was not recorded, in the order of PARTS."""
        return tuple(part for part in PARTS if part not in self.has)

    @property
    def maker(self) -> str:
        """Who made the trajectory, where a policy's id would stand: at most 64 characters."""
        return f"recording:{self.sha256[:12]}:{self.file}"[:64]

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON-ready data; `from_dict` reads it back."""
        named = {name: getattr(self, name) for name in ("file", "format", "sha256", "run")}
        shown = {"video": asdict(self.video)} if self.video is not None else {}
        return {**named, "has": list(self.has), "how": list(self.how), **shown}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Recorded:
        """Raises KeyError, TypeError or ValueError for anything that `as_dict` did not write."""
        texts = {name: str(data[name]) for name in ("file", "format", "sha256", "run")}
        shown = data.get("video")
        video = (
            Video(str(shown["sha256"]), str(shown["media"]), int(shown["bytes"]), float(shown["duration_s"]))
            if shown is not None
            else None
        )
        return cls(**texts, has=tuple(map(str, data["has"])), how=tuple(map(str, data["how"])), video=video)
