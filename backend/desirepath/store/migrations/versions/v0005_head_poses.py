"""How heads moved in headsets."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from desirepath.store.migrations.triggers import HEAD_POSE_REFUSALS
from desirepath.store.models.base import UtcDateTime

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "head_pose",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("session_id", sa.String(length=32), nullable=False),
        sa.Column("step_key", sa.String(length=80), nullable=False),
        sa.Column("trial_id", sa.String(length=32), nullable=True),
        sa.Column("side", sa.String(length=1), nullable=True),
        sa.Column("showing", sa.Integer(), nullable=True),
        sa.Column("wearing", sa.String(length=32), nullable=False),
        sa.Column("part", sa.Integer(), nullable=False),
        sa.Column("began_s", sa.Float(), nullable=False),
        sa.Column("playing_s", sa.Float(), nullable=True),
        sa.Column("samples", sa.Integer(), nullable=False),
        sa.Column("recorded", sa.JSON(), nullable=False),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.ForeignKeyConstraint(["session_id"], ["session.id"], name=op.f("fk_head_pose_session_id_session")),
        sa.ForeignKeyConstraint(["trial_id"], ["trial.id"], name=op.f("fk_head_pose_trial_id_trial")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_head_pose")),
        sa.UniqueConstraint("session_id", "wearing", "part", name=op.f("uq_head_pose_session_id_wearing_part")),
    )
    op.create_index(op.f("ix_head_pose_session_id"), "head_pose", ["session_id"])
    dialect = op.get_bind().dialect.name
    for refusal in HEAD_POSE_REFUSALS:
        for statement in refusal.ddl(dialect):
            op.execute(statement)


def downgrade() -> None:
    dialect = op.get_bind().dialect.name
    for refusal in HEAD_POSE_REFUSALS:
        for statement in refusal.drop_ddl(dialect):
            op.execute(statement)
    op.drop_table("head_pose")
