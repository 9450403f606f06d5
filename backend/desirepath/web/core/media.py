"""What routes answer that is no JSON of a model: pages, and files by their ending; the published contract says so."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from fastapi import Request
from starlette.responses import Response

from desirepath.csv_text import csv_text

PAGE = "text/html"
# Inline styles are how matplotlib colours an SVG; nothing else may happen in a figure that is opened by itself.
FIGURE_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
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
    "webp": "image/webp",
    "yaml": "application/yaml",
    "zip": "application/zip",
}


FIGURE_ENDINGS = ("png", "svg", "csv")  # a figure and its rows


def media_of(path: str) -> str:
    """The media type of a file by the last part of its path, a page's where that has no ending."""
    ending = path.rpartition("/")[2].rpartition(".")[2]
    return MEDIA.get(ending, PAGE)


def answers_with(*endings: str) -> dict[int | str, dict[str, Any]]:
    """`responses` of a route that answers with a file which its path does not name."""
    return {200: {"content": {MEDIA[ending]: {} for ending in endings}}}


def figure_file(
    request: Request, name: str, content: bytes, *, shown: Collection[str], mark: str | None = None
) -> Response:
    """A figure, or what belongs to one: endings in `shown` open in the browser, the others are saved. mark: changes
    with the content; whoever has that already is told so.
    """
    ending = name.rpartition(".")[2]
    headers = {"Cache-Control": "private, no-cache", "Content-Security-Policy": FIGURE_POLICY}
    if mark is not None:
        headers["ETag"] = f'"{mark}"'
        if request.headers.get("If-None-Match") == headers["ETag"]:
            return Response(status_code=304, headers=headers)
    if ending not in shown:
        headers["Content-Disposition"] = f'attachment; filename="{name.rpartition("/")[2]}"'
    return Response(content, media_type=MEDIA[ending], headers=headers)


def csv_response(header: list[str], rows: Any, filename: str) -> Response:
    """A CSV file to keep."""
    return Response(
        csv_text([header, *rows]),
        media_type="text/csv",
        headers={"Content-Disposition": f'attachment; filename="{filename}"'},
    )
