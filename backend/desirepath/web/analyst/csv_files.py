"""Tables of the analysts' pages as CSV files. What stands in them is the pages' own."""

from __future__ import annotations

from typing import Any

from starlette.responses import Response

from desirepath.csv_text import csv_text


def csv_response(header: list[str], rows: Any, filename: str) -> Response:
    """A CSV file to keep."""
    return Response(
        csv_text([header, *rows]),
        media_type="text/csv",
        headers={"Content-Disposition": f'attachment; filename="{filename}"'},
    )
