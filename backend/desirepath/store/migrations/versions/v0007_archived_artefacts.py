"""Artefacts can be archived: out of the lists, with their lineage kept."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("artefact", sa.Column("archived_at", sa.DateTime(timezone=True), nullable=True))
    op.add_column("artefact", sa.Column("archived_by", sa.String(length=80), nullable=True))


def downgrade() -> None:
    op.drop_column("artefact", "archived_by")
    op.drop_column("artefact", "archived_at")
