"""Logged observations in the phone's own times, and a clock that the lowest seq tells.

A downgrade leaves what was logged meanwhile in those times: an earlier release takes them for
event times.
"""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("sessions", sa.Column("clock_ahead_s", sa.Double(), nullable=True))
    op.add_column("sessions", sa.Column("clock_mono_ahead_s", sa.Double(), nullable=True))
    op.add_column("sessions", sa.Column("clock_mono_seq", sa.BigInteger(), nullable=True))
    op.add_column("observation_batches", sa.Column("monotonic", sa.LargeBinary(), nullable=True))
    op.execute("UPDATE sessions SET clock_ahead_s = clock_offset_s")
    op.execute("UPDATE sessions SET clock_mono_seq = -1 WHERE clock_mono_to_wall_s IS NOT NULL")
    op.drop_column("sessions", "clock_offset_s")


def downgrade() -> None:
    offset_s = sa.Column("clock_offset_s", sa.Double(), nullable=False, server_default="0")
    op.add_column("sessions", offset_s)
    op.execute(
        "UPDATE sessions SET clock_offset_s = clock_ahead_s "
        "WHERE NOT clock_recorded AND abs(clock_ahead_s) > 2"
    )
    op.drop_column("observation_batches", "monotonic")
    op.drop_column("sessions", "clock_mono_seq")
    op.drop_column("sessions", "clock_mono_ahead_s")
    op.drop_column("sessions", "clock_ahead_s")
