"""What routes answer that is no JSON of a model: pages, and files by their ending; the published contract says so."""

from __future__ import annotations

from typing import Any

PAGE = "text/html"
ANY_FILE = "application/octet-stream"
MEDIA = {
    "csv": "text/csv",
    "html": PAGE,
    "json": "application/json",
    "npz": ANY_FILE,
    "onnx": ANY_FILE,
    "png": "image/png",
    "svg": "image/svg+xml",
    "txt": "text/plain",
    "yaml": "application/yaml",
    "zip": "application/zip",
}


def media_of(path: str) -> str:
    """The media type of a file by the last part of its path, a page's where that has no ending."""
    ending = path.rpartition("/")[2].rpartition(".")[2]
    return MEDIA.get(ending, PAGE)


def answers_with(*endings: str) -> dict[int | str, dict[str, Any]]:
    """`responses` of a route that answers with a file which its path does not name."""
    return {200: {"content": {MEDIA[ending]: {} for ending in endings}}}
