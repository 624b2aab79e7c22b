"""Radio maps: in which order they were active, and the scatter of their levels."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("radio_maps") as radio_maps:
        radio_maps.add_column(sa.Column("activation", sa.Integer()))
        radio_maps.add_column(sa.Column("statistics", sa.LargeBinary()))
    # Of maps that were active before nothing is known; the active ones are the first known.
    op.execute(sa.text("UPDATE radio_maps SET activation = 1 WHERE active"))


def downgrade() -> None:
    with op.batch_alter_table("radio_maps") as radio_maps:
        radio_maps.drop_column("statistics")
        radio_maps.drop_column("activation")
