"""Where and when a browser signed in; sign-ins that need another step; second factors and their recovery codes."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from desirepath.store.models.base import UtcDateTime

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None


def upgrade() -> None:
    # All may stay empty: during a rolling upgrade the version before this one still writes such rows.
    op.add_column("sign_in", sa.Column("seen_at", UtcDateTime(), nullable=True))
    op.add_column("sign_in", sa.Column("address", sa.String(64), nullable=True))
    op.add_column("sign_in", sa.Column("browser", sa.String(40), nullable=True))
    op.add_column("sign_in", sa.Column("method", sa.String(16), nullable=False, server_default="password"))
    op.create_table(
        "sign_in_under_way",
        sa.Column("token_hash", sa.LargeBinary(32), nullable=False),
        sa.Column("purpose", sa.String(16), nullable=False),
        sa.Column("user_id", sa.String(32), nullable=True),
        sa.Column("data", sa.JSON(), nullable=False),
        sa.Column("expires_at", UtcDateTime(), nullable=False),
        sa.ForeignKeyConstraint(["user_id"], ["user.id"], name=op.f("fk_sign_in_under_way_user_id_user")),
        sa.PrimaryKeyConstraint("token_hash", name=op.f("pk_sign_in_under_way")),
    )
    op.create_index(op.f("ix_sign_in_under_way_user_id"), "sign_in_under_way", ["user_id"])
    op.create_table(
        "second_factor",
        sa.Column("user_id", sa.String(32), nullable=False),
        sa.Column("secret", sa.String(64), nullable=False),
        sa.Column("last_step", sa.BigInteger(), nullable=True),
        sa.Column("created_at", UtcDateTime(), nullable=False),
        sa.Column("confirmed_at", UtcDateTime(), nullable=True),
        sa.ForeignKeyConstraint(["user_id"], ["user.id"], name=op.f("fk_second_factor_user_id_user")),
        sa.PrimaryKeyConstraint("user_id", name=op.f("pk_second_factor")),
    )
    op.create_table(
        "recovery_code",
        sa.Column("code_hash", sa.LargeBinary(32), nullable=False),
        sa.Column("user_id", sa.String(32), nullable=False),
        sa.Column("used_at", UtcDateTime(), nullable=True),
        sa.ForeignKeyConstraint(["user_id"], ["user.id"], name=op.f("fk_recovery_code_user_id_user")),
        sa.PrimaryKeyConstraint("code_hash", name=op.f("pk_recovery_code")),
    )
    op.create_index(op.f("ix_recovery_code_user_id"), "recovery_code", ["user_id"])


def downgrade() -> None:
    op.drop_table("recovery_code")
    op.drop_table("second_factor")
    op.drop_table("sign_in_under_way")
    for column in ("method", "browser", "address", "seen_at"):
        op.drop_column("sign_in", column)
