"""With what headset trials were watched."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("trial", sa.Column("hmd", sa.Boolean(), nullable=True))
    op.add_column("trial", sa.Column("headset", sa.JSON(none_as_null=True), nullable=True))


def downgrade() -> None:
    op.drop_column("trial", "headset")
    op.drop_column("trial", "hmd")
