"""With what headset paths were drawn and watched."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("stroke", sa.Column("hmd", sa.Boolean(), nullable=True))
    op.add_column("stroke", sa.Column("headset", sa.JSON(none_as_null=True), nullable=True))


def downgrade() -> None:
    op.drop_column("stroke", "headset")
    op.drop_column("stroke", "hmd")
