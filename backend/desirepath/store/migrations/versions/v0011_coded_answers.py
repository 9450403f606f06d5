"""Answers in participants' own words are coded: a codebook per question, and the codes that each coder gave."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "codebook_code",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("study_id", sa.String(length=32), nullable=False),
        sa.Column("item", sa.String(length=80), nullable=False),
        sa.Column("name", sa.String(length=60), nullable=False),
        sa.Column("definition", sa.Text(), nullable=False),
        sa.Column("written_by", sa.String(length=80), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_codebook_code_study_id_study")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_codebook_code")),
        sa.UniqueConstraint("study_id", "item", "name", name=op.f("uq_codebook_code_study_id_item_name")),
    )
    op.create_index(op.f("ix_codebook_code_study_id"), "codebook_code", ["study_id"])
    op.create_table(
        "coding",
        sa.Column("id", sa.String(length=32), nullable=False),
        sa.Column("study_id", sa.String(length=32), nullable=False),
        sa.Column("response_id", sa.String(length=32), nullable=False),
        sa.Column("item", sa.String(length=80), nullable=False),
        sa.Column("role", sa.String(length=10), nullable=False),
        sa.Column("coder", sa.String(length=80), nullable=False),
        sa.Column("codes", sa.JSON(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint("role in ('first', 'second', 'agreed')", name=op.f("ck_coding_role")),
        sa.ForeignKeyConstraint(["response_id"], ["response.id"], name=op.f("fk_coding_response_id_response")),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_coding_study_id_study")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_coding")),
        sa.UniqueConstraint("response_id", "item", "role", name=op.f("uq_coding_response_id_item_role")),
    )
    op.create_index(op.f("ix_coding_response_id"), "coding", ["response_id"])
    op.create_index(op.f("ix_coding_study_id"), "coding", ["study_id"])


def downgrade() -> None:
    op.drop_table("coding")
    op.drop_table("codebook_code")
