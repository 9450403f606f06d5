"""Since when a session stands at its step, by the server's clock: time limits and breaks count from there."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("session", sa.Column("step_since", sa.DateTime(timezone=True), nullable=True))


def downgrade() -> None:
    op.drop_column("session", "step_since")
