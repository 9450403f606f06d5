"""What a whole study needs: counterbalancing, appointments, protocol versions, purposes of consent, probes."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from alembic import op

from desirepath.store.migrations.triggers import SECOND_REFUSALS

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

STATES_BEFORE = "'active', 'paused', 'completed', 'withdrawn', 'expired'"
STATES = f"{STATES_BEFORE}, 'screened_out'"


def upgrade() -> None:
    op.create_table(
        "protocol_version",
        sa.Column("study_id", sa.String(length=32), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("protocol_version", sa.Integer(), nullable=False),
        sa.Column("protocol_yaml", sa.Text(), nullable=False),
        sa.Column("protocol", sa.JSON(), nullable=False),
        sa.Column("files", sa.JSON(), nullable=False),
        sa.Column("protocol_hash", sa.String(length=64), nullable=False),
        sa.Column("changes", sa.JSON(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("created_by", sa.String(length=80), nullable=True),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_protocol_version_study_id_study")),
        sa.PrimaryKeyConstraint("study_id", "number", name=op.f("pk_protocol_version")),
    )
    for table, columns in _added().items():
        for column in columns:
            op.add_column(table, column)
    _states(STATES_BEFORE, STATES)
    for refusal in SECOND_REFUSALS:
        for statement in refusal.ddl(op.get_bind().dialect.name):
            op.execute(statement)


def downgrade() -> None:
    for refusal in SECOND_REFUSALS:
        for statement in refusal.drop_ddl(op.get_bind().dialect.name):
            op.execute(statement)
    _states(STATES, STATES_BEFORE)
    for table, columns in reversed(_added().items()):
        for column in reversed(columns):
            op.drop_column(table, column.name)
    op.drop_table("protocol_version")


def _states(before: str, after: str) -> None:
    """Change the states that a session may have.

    SQLite cannot alter a check, and making the table anew would lose its triggers and every key that points to it. What
    is stored does not change, so the table's text is corrected in place, as https://www.sqlite.org/lang_altertable.html
    shows in section 7 for such changes.
    """
    connection = op.get_bind()
    if connection.dialect.name != "sqlite":
        op.drop_constraint(op.f("ck_session_state"), "session", type_="check")
        op.create_check_constraint(op.f("ck_session_state"), "session", f"state in ({after})")
        return
    version = connection.exec_driver_sql("PRAGMA schema_version").scalar_one()
    connection.exec_driver_sql("PRAGMA writable_schema = ON")
    connection.exec_driver_sql(
        "UPDATE sqlite_master SET sql = replace(sql, ?, ?) WHERE type = 'table' AND name = 'session'",
        (f"state in ({before})", f"state in ({after})"),
    )
    connection.exec_driver_sql(f"PRAGMA schema_version = {version + 1}")
    connection.exec_driver_sql("PRAGMA writable_schema = OFF")


def _added() -> dict[str, tuple[sa.Column[Any], ...]]:
    return {
        "participant": (sa.Column("consents", sa.JSON(), nullable=True),),
        "session": (
            sa.Column("assignment", sa.JSON(), nullable=True),
            sa.Column("appointment", sa.Integer(), nullable=False, server_default="1"),
            sa.Column("protocol_number", sa.Integer(), nullable=False, server_default="1"),
            sa.Column("ended_because", sa.String(length=80), nullable=True),
            sa.Column("opens_at", sa.DateTime(timezone=True), nullable=True),
        ),
        "trial": (
            sa.Column("replays", sa.Integer(), nullable=False, server_default="0"),
            sa.Column("probe_of", sa.String(length=32), nullable=True),
            sa.Column("turned", sa.Boolean(), nullable=True),
        ),
        "response": (sa.Column("consent_id", sa.String(length=32), nullable=True),),
    }
