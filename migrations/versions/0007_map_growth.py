"""Sessions kept aside for radio maps to grow by."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("sites") as sites:
        grow_map = sa.Column(
            "grow_map", sa.Boolean(), nullable=False, server_default=sa.text("false")
        )
        sites.add_column(grow_map)
    op.create_table(
        "quarantined_sessions",
        sa.Column("session_id", sa.String(), nullable=False),
        sa.Column("site_id", sa.String(), nullable=False),
        sa.Column("collected_s", sa.Double(), nullable=False),
        sa.Column("decided_s", sa.Double(), nullable=True),
        sa.Column("payload", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["session_id"],
            ["sessions.id"],
            name=op.f("fk_quarantined_sessions_session_id_sessions"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["site_id"],
            ["sites.id"],
            name=op.f("fk_quarantined_sessions_site_id_sites"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("session_id", name=op.f("pk_quarantined_sessions")),
    )
    op.create_index(op.f("ix_quarantined_sessions_site_id"), "quarantined_sessions", ["site_id"])


def downgrade() -> None:
    op.drop_table("quarantined_sessions")
    with op.batch_alter_table("sites") as sites:
        sites.drop_column("grow_map")
