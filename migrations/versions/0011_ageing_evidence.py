"""What is told of aged transmitters: scans that misplace them, instead of residuals."""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None


def upgrade() -> None:
    # What is not quarantined is found anew within a day; what is stays so, its evidence unknown.
    op.execute("DELETE FROM aged_transmitters WHERE NOT quarantined")
    with op.batch_alter_table("aged_transmitters") as aged:
        aged.drop_column("residual")
        aged.drop_column("map_residual")
        aged.drop_column("heard")
        for name, kind in (("excess", sa.Double()), ("misplaced", sa.Integer())):
            aged.add_column(sa.Column(name, kind, nullable=False, server_default=sa.text("0")))


def downgrade() -> None:
    op.execute("DELETE FROM aged_transmitters WHERE NOT quarantined")
    with op.batch_alter_table("aged_transmitters") as aged:
        aged.drop_column("excess")
        aged.drop_column("misplaced")
        for name in ("residual", "map_residual", "heard"):
            aged.add_column(
                sa.Column(name, sa.Double(), nullable=False, server_default=sa.text("0"))
            )
