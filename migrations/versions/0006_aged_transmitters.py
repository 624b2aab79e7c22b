"""Transmitters that traffic contradicts, by radio map."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "aged_transmitters",
        sa.Column("radio_map_id", sa.String(), nullable=False),
        sa.Column("key", sa.String(), nullable=False),
        sa.Column("change", sa.String(), nullable=False),
        sa.Column("residual", sa.Double(), nullable=False),
        sa.Column("map_residual", sa.Double(), nullable=False),
        sa.Column("heard", sa.Double(), nullable=False),
        sa.Column("expected", sa.Double(), nullable=False),
        sa.Column("scans", sa.Integer(), nullable=False),
        sa.Column("found_s", sa.Double(), nullable=False),
        sa.Column("quarantined", sa.Boolean(), nullable=False, server_default=sa.text("false")),
        sa.ForeignKeyConstraint(["radio_map_id"], ["radio_maps.id"], ondelete="CASCADE"),
        sa.PrimaryKeyConstraint("radio_map_id", "key"),
    )


def downgrade() -> None:
    op.drop_table("aged_transmitters")
