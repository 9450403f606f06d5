"""Tables of the analysts' pages as CSV files. What stands in them is the pages' own."""

from __future__ import annotations

import csv
import io
from typing import Any

from starlette.responses import Response


def csv_response(header: list[str], rows: Any, filename: str) -> Response:
    """A CSV file to keep."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return Response(
        out.getvalue(), media_type="text/csv", headers={"Content-Disposition": f'attachment; filename="{filename}"'}
    )
