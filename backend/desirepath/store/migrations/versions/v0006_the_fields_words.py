"""The field's words: `sides_swapped` (was `turned`), role `practice` (was `learning`)."""

from __future__ import annotations

from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.execute("ALTER TABLE trial RENAME COLUMN turned TO sides_swapped")
    op.execute("UPDATE trial SET role = 'practice' WHERE role = 'learning'")


def downgrade() -> None:
    op.execute("UPDATE trial SET role = 'learning' WHERE role = 'practice'")
    op.execute("ALTER TABLE trial RENAME COLUMN sides_swapped TO turned")
