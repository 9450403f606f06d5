"""`python -m desirepath.store.migrations "what changes"`: drafts the next revision from what `models` says now.

Read the draft before you commit it: Alembic sees neither triggers nor renamed columns.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from alembic import command
from alembic.script import Script

from desirepath.store.database import Database, migration_config


def draft_revision(message: str, number: str) -> Path:
    """Write the difference between the newest revision and the models as revision `number`; returns its file."""
    with tempfile.TemporaryDirectory() as folder:
        database = Database(f"sqlite:///{folder}/newest.sqlite")
        database.migrate()
        with database.engine.begin() as connection:
            drafted = command.revision(migration_config(connection), message, autogenerate=True, rev_id=number)
        database.close()
    if not isinstance(drafted, Script):
        raise RuntimeError(f"alembic drafted {drafted!r} instead of one revision")
    return Path(drafted.path)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    existing = len(list((Path(__file__).parent / "versions").glob("v*.py")))
    sys.stdout.write(f"{draft_revision(sys.argv[1], f'{existing + 1:04d}')}\n")
