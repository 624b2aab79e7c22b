"""Sessions whose profile changes while they last."""

import sqlalchemy as sa
from alembic import op

from app.storage.columns import ExactFloat

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

EXACT_FLOAT = sa.Double().with_variant(ExactFloat(), "sqlite")


def upgrade() -> None:
    with op.batch_alter_table("sessions") as sessions:
        named = sa.Column(
            "profile_named", sa.Boolean(), nullable=False, server_default=sa.text("false")
        )
        sessions.add_column(named)
        sessions.add_column(sa.Column("profile_since_s", EXACT_FLOAT))
    with op.batch_alter_table("snapshots") as snapshots:
        snapshots.add_column(sa.Column("profile", sa.String(), nullable=False, server_default=""))


def downgrade() -> None:
    with op.batch_alter_table("snapshots") as snapshots:
        snapshots.drop_column("profile")
    with op.batch_alter_table("sessions") as sessions:
        sessions.drop_column("profile_since_s")
        sessions.drop_column("profile_named")
