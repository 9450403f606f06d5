"""Sessions keep whether a person's answers look like what is believed of them."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("session", sa.Column("predictive_check", sa.JSON(), nullable=True))


def downgrade() -> None:
    op.drop_column("session", "predictive_check")
