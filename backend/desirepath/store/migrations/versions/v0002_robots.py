"""Robots of studies and their runs."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from desirepath.store.models.base import UtcDateTime

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "study_robot",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("study_id", sa.String(length=32), nullable=False),
        sa.Column("name", sa.String(length=80), nullable=False),
        sa.Column("token_hash", sa.String(length=64), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("person", sa.JSON(none_as_null=True), nullable=True),
        sa.Column("made_by", sa.String(length=80), nullable=False),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.Column("revoked_at", UtcDateTime(), nullable=True),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_study_robot_study_id_study")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_study_robot")),
        sa.UniqueConstraint("token_hash", name=op.f("uq_study_robot_token_hash")),
    )
    op.create_index(op.f("ix_study_robot_study_id"), "study_robot", ["study_id"])

    op.create_table(
        "robot_run",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("study_id", sa.String(length=32), nullable=False),
        sa.Column("robot_id", sa.String(length=32), nullable=True),
        sa.Column("session_id", sa.String(length=32), nullable=True),
        sa.Column("step_key", sa.String(length=80), nullable=True),
        sa.Column("simulated", sa.Boolean(), server_default=sa.false(), nullable=False),
        sa.Column("setup", sa.String(length=40), nullable=False),
        sa.Column("goal", sa.JSON(), nullable=False),
        sa.Column("weights", sa.JSON(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("answers", sa.Integer(), nullable=False),
        sa.Column("asked_at", UtcDateTime(), nullable=True),
        sa.Column("started_by", sa.String(length=80), nullable=True),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.Column("started_at", UtcDateTime(), nullable=True),
        sa.Column("moved_at", UtcDateTime(), nullable=True),
        sa.Column("ended_at", UtcDateTime(), nullable=True),
        sa.Column("recording", sa.String(length=64), nullable=True),
        sa.Column("summary", sa.JSON(none_as_null=True), nullable=True),
        sa.CheckConstraint("state in ('waiting', 'started', 'over')", name=op.f("ck_robot_run_state")),
        sa.ForeignKeyConstraint(["robot_id"], ["study_robot.id"], name=op.f("fk_robot_run_robot_id_study_robot")),
        sa.ForeignKeyConstraint(["session_id"], ["session.id"], name=op.f("fk_robot_run_session_id_session")),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_robot_run_study_id_study")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_robot_run")),
        sa.UniqueConstraint("session_id", "step_key", name=op.f("uq_robot_run_session_id_step_key")),
    )
    for column in ("robot_id", "session_id", "study_id"):
        op.create_index(op.f(f"ix_robot_run_{column}"), "robot_run", [column])


def downgrade() -> None:
    op.drop_table("robot_run")
    op.drop_table("study_robot")
