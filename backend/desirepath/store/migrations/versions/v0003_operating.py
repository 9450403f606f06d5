"""Operating a study: roles, an audit log, notes, pilot participants, how long data are kept."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from desirepath.store.migrations.triggers import THIRD_REFUSALS

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "note",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("participant_id", sa.String(length=32), nullable=False),
        sa.Column("session_id", sa.String(length=32), nullable=True),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("written_by", sa.String(length=80), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["participant_id"], ["participant.id"], name=op.f("fk_note_participant_id_participant")
        ),
        sa.ForeignKeyConstraint(["session_id"], ["session.id"], name=op.f("fk_note_session_id_session")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_note")),
    )
    op.create_table(
        "audit",
        sa.Column("id", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("by", sa.String(length=80), nullable=False),
        sa.Column("role", sa.String(length=16), nullable=True),
        sa.Column("action", sa.String(length=60), nullable=False),
        sa.Column("outcome", sa.String(length=16), nullable=False),
        sa.Column("study_id", sa.String(length=32), nullable=True),
        sa.Column("participant_id", sa.String(length=32), nullable=True),
        sa.Column("data", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_audit")),
    )
    for table, column in _INDICES:
        op.create_index(op.f(f"ix_{table}_{column}"), table, [column])
    op.add_column("user", sa.Column("role", sa.String(length=16), nullable=False, server_default="viewer"))
    op.execute("""UPDATE "user" SET role = 'owner'""")  # until now everybody with an account could do everything
    op.add_column("study", sa.Column("pilot", sa.Boolean(), nullable=False, server_default=sa.false()))
    op.add_column("study", sa.Column("retain_until", sa.DateTime(timezone=True), nullable=True))
    op.add_column("participant", sa.Column("pilot", sa.Boolean(), nullable=False, server_default=sa.false()))
    for refusal in THIRD_REFUSALS:
        for statement in refusal.ddl(op.get_bind().dialect.name):
            op.execute(statement)


def downgrade() -> None:
    for refusal in THIRD_REFUSALS:
        for statement in refusal.drop_ddl(op.get_bind().dialect.name):
            op.execute(statement)
    op.drop_column("participant", "pilot")
    op.drop_column("study", "retain_until")
    op.drop_column("study", "pilot")
    op.drop_column("user", "role")
    op.drop_table("audit")
    op.drop_table("note")


_INDICES = (
    ("note", "participant_id"),
    ("note", "session_id"),
    ("audit", "at"),
    ("audit", "action"),
    ("audit", "study_id"),
    ("audit", "participant_id"),
)
