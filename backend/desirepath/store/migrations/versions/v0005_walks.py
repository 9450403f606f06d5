"""Walks: how the person walked while the robot drove a drawn path. Who drew before stood still."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from desirepath.store.migrations.triggers import FIFTH_REFUSALS

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("stroke", sa.Column("walk", sa.JSON(none_as_null=True), nullable=True))
    for refusal in FIFTH_REFUSALS:
        for statement in refusal.ddl(op.get_bind().dialect.name):
            op.execute(statement)


def downgrade() -> None:
    for refusal in FIFTH_REFUSALS:
        for statement in refusal.drop_ddl(op.get_bind().dialect.name):
            op.execute(statement)
    op.drop_column("stroke", "walk")
