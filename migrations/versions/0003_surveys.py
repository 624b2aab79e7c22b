"""Surveys as they were walked, and jobs.

The tables of reference points and their scans go: no build ever wrote to them.
"""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

ROW_ID = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    op.drop_table("survey_scans")
    op.drop_table("reference_points")
    with op.batch_alter_table("surveys") as surveys:
        complete = sa.Column(
            "complete", sa.Boolean(), nullable=False, server_default=sa.text("false")
        )
        surveys.add_column(complete)
        surveys.add_column(sa.Column("holdings", sa.JSON()))
        surveys.add_column(sa.Column("unusable", sa.JSON()))
    _create_survey_records()
    _create_jobs()


def downgrade() -> None:
    op.drop_table("jobs")
    op.drop_table("survey_records")
    with op.batch_alter_table("surveys") as surveys:
        surveys.drop_column("unusable")
        surveys.drop_column("holdings")
        surveys.drop_column("complete")
    _create_reference_points()


def _create_survey_records() -> None:
    op.create_table(
        "survey_records",
        sa.Column("id", ROW_ID, nullable=False),
        sa.Column("survey_id", sa.String(), nullable=False),
        sa.Column("floor_id", sa.String(), nullable=False),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("walk", sa.String(), server_default="", nullable=False),
        sa.Column("first_s", sa.Double(), nullable=True),
        sa.Column("last_s", sa.Double(), nullable=True),
        sa.Column("payload", sa.LargeBinary(), nullable=False),
        sa.CheckConstraint("kind IN ('walk', 'points')", name=op.f("ck_survey_records_kind")),
        sa.ForeignKeyConstraint(
            ["survey_id"],
            ["surveys.id"],
            name=op.f("fk_survey_records_survey_id_surveys"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_survey_records")),
    )
    op.create_index(op.f("ix_survey_records_survey_id"), "survey_records", ["survey_id"])


def _create_jobs() -> None:
    op.create_table(
        "jobs",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("site_id", sa.String(), nullable=False),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("state", sa.String(), nullable=False),
        sa.Column("progress", sa.JSON(), nullable=False),
        sa.Column("result", sa.JSON(), nullable=True),
        sa.Column("problem", sa.JSON(), nullable=True),
        sa.Column("created_s", sa.Double(), nullable=False),
        sa.Column("ended_s", sa.Double(), nullable=True),
        sa.CheckConstraint(
            "state IN ('receiving', 'waiting', 'running', 'done', 'failed')",
            name=op.f("ck_jobs_state"),
        ),
        sa.ForeignKeyConstraint(
            ["site_id"], ["sites.id"], name=op.f("fk_jobs_site_id_sites"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_jobs")),
    )
    op.create_index(op.f("ix_jobs_site_id"), "jobs", ["site_id"])


def _create_reference_points() -> None:
    op.create_table(
        "reference_points",
        sa.Column("id", ROW_ID, nullable=False),
        sa.Column("survey_id", sa.String(), nullable=False),
        sa.Column("floor_id", sa.String(), nullable=False),
        sa.Column("walk", sa.String(), server_default="", nullable=False),
        sa.Column("name", sa.String(), server_default="", nullable=False),
        sa.Column("x_m", sa.Double(), nullable=False),
        sa.Column("y_m", sa.Double(), nullable=False),
        sa.Column("time_s", sa.Double(), nullable=True),
        sa.ForeignKeyConstraint(
            ["floor_id"],
            ["floors.id"],
            name=op.f("fk_reference_points_floor_id_floors"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["survey_id"],
            ["surveys.id"],
            name=op.f("fk_reference_points_survey_id_surveys"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_reference_points")),
    )
    op.create_index(op.f("ix_reference_points_floor_id"), "reference_points", ["floor_id"])
    op.create_index(op.f("ix_reference_points_survey_id"), "reference_points", ["survey_id"])
    op.create_table(
        "survey_scans",
        sa.Column("id", ROW_ID, nullable=False),
        sa.Column("reference_point_id", ROW_ID, nullable=False),
        sa.Column("time_s", sa.Double(), nullable=False),
        sa.Column("payload", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["reference_point_id"],
            ["reference_points.id"],
            name=op.f("fk_survey_scans_reference_point_id_reference_points"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_survey_scans")),
    )
    op.create_index(
        op.f("ix_survey_scans_reference_point_id"), "survey_scans", ["reference_point_id"]
    )
