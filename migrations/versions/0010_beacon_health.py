"""When beacons were last heard, and what they told of themselves."""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "beacon_health",
        sa.Column("beacon_id", sa.String(), nullable=False),
        sa.Column("last_heard_s", sa.Double(), nullable=False),
        sa.Column("told_s", sa.Double(), nullable=True),
        sa.Column("battery_percent", sa.Double(), nullable=True),
        sa.Column("battery_v", sa.Double(), nullable=True),
        sa.Column("temperature_degc", sa.Double(), nullable=True),
        sa.ForeignKeyConstraint(
            ["beacon_id"],
            ["beacons.id"],
            name=op.f("fk_beacon_health_beacon_id_beacons"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("beacon_id", name=op.f("pk_beacon_health")),
    )


def downgrade() -> None:
    op.drop_table("beacon_health")
