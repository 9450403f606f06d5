"""Drawn paths: every stroke that a participant drew, kept whatever came of it."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from desirepath.store.migrations.triggers import FOURTH_REFUSALS

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "stroke",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("session_id", sa.String(length=32), nullable=False),
        sa.Column("step_key", sa.String(length=80), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("environment", sa.String(length=40), nullable=False),
        sa.Column("pair", sa.Integer(), nullable=False),
        sa.Column("view", sa.String(length=20), nullable=False),
        sa.Column("pointer", sa.String(length=40), nullable=False),
        sa.Column("drawn", sa.JSON(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("problem", sa.JSON(), nullable=True),
        sa.Column("demonstration", sa.String(length=64), nullable=True),
        sa.Column("trajectory", sa.String(length=64), nullable=True),
        sa.Column("shown_since", sa.DateTime(timezone=True), nullable=True),
        sa.Column("watched_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("request_id", sa.String(length=64), nullable=False),
        sa.Column("client_time", sa.DateTime(timezone=True), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("left_out_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("left_out_by", sa.String(length=80), nullable=True),
        sa.Column("left_out_reason", sa.Text(), nullable=True),
        sa.CheckConstraint("state in ('refused', 'drawn', 'watched', 'kept', 'redone')", name=op.f("ck_stroke_state")),
        sa.ForeignKeyConstraint(["session_id"], ["session.id"], name=op.f("fk_stroke_session_id_session")),
        sa.ForeignKeyConstraint(["trajectory"], ["trajectory.id"], name=op.f("fk_stroke_trajectory_trajectory")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_stroke")),
        sa.UniqueConstraint("request_id", name=op.f("uq_stroke_request_id")),
        sa.UniqueConstraint("session_id", "step_key", "attempt", name=op.f("uq_stroke_session_id_step_key_attempt")),
    )
    op.create_index(op.f("ix_stroke_session_id"), "stroke", ["session_id"])
    for refusal in FOURTH_REFUSALS:
        for statement in refusal.ddl(op.get_bind().dialect.name):
            op.execute(statement)


def downgrade() -> None:
    for refusal in FOURTH_REFUSALS:
        for statement in refusal.drop_ddl(op.get_bind().dialect.name):
            op.execute(statement)
    op.drop_index(op.f("ix_stroke_session_id"), "stroke")
    op.drop_table("stroke")
