"""Names of setups as long as those of their folders may be: 60 characters."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

TABLES = ("artefact", "trajectory", "robot_run")


def upgrade() -> None:
    _change(40, 60)


def downgrade() -> None:
    _change(60, 40)


def _change(before: int, after: int) -> None:
    if op.get_bind().dialect.name == "sqlite":
        _declare(before, after)
        return
    for table in TABLES:
        op.alter_column(table, "setup", existing_type=sa.String(before), type_=sa.String(after))


def _declare(before: int, after: int) -> None:
    """SQLite keeps a column's length as a word of its schema and holds nobody to it: the word alone is changed, as its
    manual describes it for what changes no row; a table made anew would lose the rows that point to it."""
    version = op.get_bind().exec_driver_sql("PRAGMA schema_version").scalar_one()
    names = ", ".join(f"'{table}'" for table in TABLES)
    op.execute("PRAGMA writable_schema = ON")
    op.execute(
        f"UPDATE sqlite_master SET sql = replace(sql, 'setup VARCHAR({before})', 'setup VARCHAR({after})') "  # noqa: S608
        f"WHERE type = 'table' AND name IN ({names})"
    )
    op.execute(f"PRAGMA schema_version = {version + 1}")
    op.execute("PRAGMA writable_schema = OFF")
