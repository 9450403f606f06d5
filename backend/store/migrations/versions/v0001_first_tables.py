"""The first tables and what they refuse."""

from __future__ import annotations

from alembic import op

from backend.store.migrations.triggers import FIRST_REFUSALS
from backend.store.models import Base

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    Base.metadata.create_all(op.get_bind())
    for refusal in FIRST_REFUSALS:
        for statement in refusal.ddl(op.get_bind().dialect.name):
            op.execute(statement)


def downgrade() -> None:
    for refusal in FIRST_REFUSALS:
        for statement in refusal.drop_ddl(op.get_bind().dialect.name):
            op.execute(statement)
    Base.metadata.drop_all(op.get_bind())
