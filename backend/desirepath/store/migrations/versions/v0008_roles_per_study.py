"""Roles in single studies, beside the one of the installation."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "study_role",
        sa.Column("user_id", sa.String(length=32), nullable=False),
        sa.Column("study_id", sa.String(length=32), nullable=False),
        sa.Column("role", sa.String(length=16), nullable=False),
        sa.Column("given_by", sa.String(length=80), nullable=False),
        sa.Column("given_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["user_id"], ["user.id"], name=op.f("fk_study_role_user_id_user")),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_study_role_study_id_study")),
        sa.PrimaryKeyConstraint("user_id", "study_id", "role", name=op.f("pk_study_role")),
    )
    op.create_index(op.f("ix_study_role_study_id"), "study_role", ["study_id"])


def downgrade() -> None:
    op.drop_table("study_role")
