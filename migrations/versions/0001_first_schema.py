"""First schema."""

import sqlalchemy as sa
from alembic import op

from app.storage.columns import ExactFloat

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

EXACT_FLOAT = sa.Double().with_variant(ExactFloat(), "sqlite")
ROW_ID = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
TABLES = (
    "sites",
    "floors",
    "beacons",
    "beacon_keys",
    "devices",
    "tokens",
    "surveys",
    "reference_points",
    "survey_scans",
    "radio_maps",
    "sessions",
    "observation_batches",
    "snapshots",
    "track_points",
)


def upgrade() -> None:
    _create_sites()
    _create_floors()
    _create_beacons_and_keys()
    _create_devices_and_tokens()
    _create_surveys()
    _create_reference_points()
    _create_survey_scans()
    _create_radio_maps()
    _create_sessions()
    _create_batches_and_snapshots()
    _create_track_points()


def downgrade() -> None:
    for table in reversed(TABLES):
        op.drop_table(table)


def _create_sites() -> None:
    op.create_table(
        "sites",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("retention_days", sa.Double(), nullable=True),
        sa.Column("default_profile", sa.String(), server_default="best", nullable=False),
        sa.Column("georeference", sa.JSON(), nullable=True),
        sa.Column("created_s", sa.Double(), nullable=False),
        sa.Column("model_version", sa.Integer(), server_default="1", nullable=False),
        sa.Column("row_version", sa.Integer(), server_default="1", nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_sites")),
    )


def _create_floors() -> None:
    op.create_table(
        "floors",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("site_id", sa.String(), nullable=False),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("building", sa.String(), server_default="", nullable=False),
        sa.Column("ordinal", sa.Integer(), nullable=False),
        sa.Column("x0_m", sa.Double(), nullable=False),
        sa.Column("y0_m", sa.Double(), nullable=False),
        sa.Column("width_m", sa.Double(), nullable=False),
        sa.Column("height_m", sa.Double(), nullable=False),
        sa.Column("plan_image", sa.LargeBinary(), nullable=True),
        sa.Column("plan_media_type", sa.String(), nullable=True),
        sa.Column("map", sa.JSON(), nullable=True),
        sa.Column("walkable", sa.LargeBinary(), nullable=True),
        sa.Column("georeference", sa.JSON(), nullable=True),
        sa.Column("row_version", sa.Integer(), server_default="1", nullable=False),
        sa.CheckConstraint("width_m > 0 AND height_m > 0", name=op.f("ck_floors_size")),
        sa.ForeignKeyConstraint(
            ["site_id"], ["sites.id"], name=op.f("fk_floors_site_id_sites"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_floors")),
        sa.UniqueConstraint(
            "site_id", "building", "name", name=op.f("uq_floors_site_id_building_name")
        ),
    )


def _create_beacons_and_keys() -> None:
    op.create_table(
        "beacons",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("site_id", sa.String(), nullable=False),
        sa.Column("floor_id", sa.String(), nullable=True),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("name", sa.String(), server_default="", nullable=False),
        sa.Column("x_m", sa.Double(), nullable=True),
        sa.Column("y_m", sa.Double(), nullable=True),
        sa.Column("z_m", sa.Double(), server_default="0", nullable=False),
        sa.Column("ref_level_dbm", sa.Double(), nullable=False),
        sa.Column("ref_distance_m", sa.Double(), nullable=False),
        sa.Column("path_loss_exponent", sa.Double(), nullable=False),
        sa.Column("shadowing_db", sa.Double(), nullable=False),
        sa.Column("row_version", sa.Integer(), server_default="1", nullable=False),
        sa.CheckConstraint("kind IN ('ble', 'wifi')", name=op.f("ck_beacons_kind")),
        sa.ForeignKeyConstraint(
            ["floor_id"],
            ["floors.id"],
            name=op.f("fk_beacons_floor_id_floors"),
            ondelete="SET NULL",
        ),
        sa.ForeignKeyConstraint(
            ["site_id"], ["sites.id"], name=op.f("fk_beacons_site_id_sites"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_beacons")),
    )
    op.create_index(op.f("ix_beacons_floor_id"), "beacons", ["floor_id"])
    op.create_index(op.f("ix_beacons_site_id"), "beacons", ["site_id"])
    op.create_table(
        "beacon_keys",
        sa.Column("site_id", sa.String(), nullable=False),
        sa.Column("key", sa.String(), nullable=False),
        sa.Column("beacon_id", sa.String(), nullable=False),
        sa.Column("rank", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(
            ["beacon_id"],
            ["beacons.id"],
            name=op.f("fk_beacon_keys_beacon_id_beacons"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["site_id"], ["sites.id"], name=op.f("fk_beacon_keys_site_id_sites"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("site_id", "key", name=op.f("pk_beacon_keys")),
    )
    op.create_index(op.f("ix_beacon_keys_beacon_id"), "beacon_keys", ["beacon_id"])


def _create_devices_and_tokens() -> None:
    op.create_table(
        "devices",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("site_id", sa.String(), nullable=True),
        sa.Column("name", sa.String(), server_default="", nullable=False),
        sa.Column("person", sa.String(), nullable=True),
        sa.Column("platform", sa.String(), nullable=True),
        sa.Column("model", sa.String(), nullable=True),
        sa.Column("profile", sa.String(), nullable=True),
        sa.Column("level_offset_db", sa.Double(), server_default="0", nullable=False),
        sa.Column("first_seen_s", sa.Double(), nullable=True),
        sa.Column("last_seen_s", sa.Double(), nullable=True),
        sa.Column("row_version", sa.Integer(), server_default="1", nullable=False),
        sa.ForeignKeyConstraint(
            ["site_id"], ["sites.id"], name=op.f("fk_devices_site_id_sites"), ondelete="SET NULL"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_devices")),
    )
    op.create_index(op.f("ix_devices_site_id"), "devices", ["site_id"])
    op.create_table(
        "tokens",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("token_hash", sa.LargeBinary(), nullable=False),
        sa.Column("role", sa.String(), nullable=False),
        sa.Column("site_id", sa.String(), nullable=True),
        sa.Column("device_id", sa.String(), nullable=True),
        sa.Column("device_prefix", sa.String(), nullable=True),
        sa.Column("label", sa.String(), server_default="", nullable=False),
        sa.Column("created_s", sa.Double(), nullable=False),
        sa.Column("expires_s", sa.Double(), nullable=True),
        sa.Column("revoked_s", sa.Double(), nullable=True),
        sa.CheckConstraint(
            "role IN ('admin', 'supervisor', 'surveyor', 'viewer', 'device')",
            name=op.f("ck_tokens_role"),
        ),
        sa.ForeignKeyConstraint(
            ["site_id"], ["sites.id"], name=op.f("fk_tokens_site_id_sites"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_tokens")),
        sa.UniqueConstraint("token_hash", name=op.f("uq_tokens_token_hash")),
    )
    op.create_index(op.f("ix_tokens_site_id"), "tokens", ["site_id"])


def _create_surveys() -> None:
    op.create_table(
        "surveys",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("site_id", sa.String(), nullable=False),
        sa.Column("name", sa.String(), server_default="", nullable=False),
        sa.Column("format", sa.String(), nullable=False),
        sa.Column("device_id", sa.String(), nullable=True),
        sa.Column("device_model", sa.String(), nullable=True),
        sa.Column("created_s", sa.Double(), nullable=False),
        sa.Column("row_version", sa.Integer(), server_default="1", nullable=False),
        sa.ForeignKeyConstraint(
            ["site_id"], ["sites.id"], name=op.f("fk_surveys_site_id_sites"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_surveys")),
    )
    op.create_index(op.f("ix_surveys_site_id"), "surveys", ["site_id"])


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


def _create_survey_scans() -> None:
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


def _create_radio_maps() -> None:
    op.create_table(
        "radio_maps",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("site_id", sa.String(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("active", sa.Boolean(), server_default=sa.text("false"), nullable=False),
        sa.Column("label", sa.String(), server_default="", nullable=False),
        sa.Column("provenance", sa.JSON(), nullable=True),
        sa.Column("fingerprints", sa.Integer(), nullable=False),
        sa.Column("transmitters", sa.Integer(), nullable=False),
        sa.Column("created_s", sa.Double(), nullable=False),
        sa.Column("payload", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["site_id"], ["sites.id"], name=op.f("fk_radio_maps_site_id_sites"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_radio_maps")),
        sa.UniqueConstraint("site_id", "version", name=op.f("uq_radio_maps_site_id_version")),
    )
    op.create_index(
        "uq_radio_maps_active",
        "radio_maps",
        ["site_id"],
        unique=True,
        sqlite_where=sa.text("active"),
        postgresql_where=sa.text("active"),
    )


def _create_sessions() -> None:
    op.create_table(
        "sessions",
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("device_id", sa.String(), nullable=False),
        sa.Column("session", sa.String(), nullable=False),
        sa.Column("site_id", sa.String(), nullable=False),
        sa.Column("profile", sa.String(), nullable=False),
        sa.Column("clock_recorded", sa.Boolean(), nullable=False),
        sa.Column("clock_offset_s", sa.Double(), nullable=False),
        sa.Column("clock_mono_to_wall_s", sa.Double(), nullable=True),
        sa.Column("clock_boot_id", sa.String(), nullable=True),
        sa.Column("opened_s", sa.Double(), nullable=False),
        sa.Column("finished", sa.Boolean(), server_default=sa.text("false"), nullable=False),
        sa.ForeignKeyConstraint(
            ["device_id"],
            ["devices.id"],
            name=op.f("fk_sessions_device_id_devices"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["site_id"], ["sites.id"], name=op.f("fk_sessions_site_id_sites"), ondelete="CASCADE"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_sessions")),
        sa.UniqueConstraint("device_id", "session", name=op.f("uq_sessions_device_id_session")),
    )
    op.create_index(op.f("ix_sessions_site_id"), "sessions", ["site_id"])


def _create_batches_and_snapshots() -> None:
    op.create_table(
        "observation_batches",
        sa.Column("id", ROW_ID, nullable=False),
        sa.Column("session_id", sa.String(), nullable=False),
        sa.Column("seq", sa.BigInteger(), nullable=False),
        sa.Column("digest", sa.LargeBinary(), nullable=False),
        sa.Column("received_s", sa.Double(), nullable=False),
        sa.Column("first_s", sa.Double(), nullable=True),
        sa.Column("last_s", sa.Double(), nullable=True),
        sa.Column("has_imu", sa.Boolean(), nullable=False),
        sa.Column("payload", sa.LargeBinary(), nullable=False),
        sa.Column("rejected", sa.LargeBinary(), nullable=False),
        sa.Column("ignored", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(
            ["session_id"],
            ["sessions.id"],
            name=op.f("fk_observation_batches_session_id_sessions"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_observation_batches")),
        sa.UniqueConstraint(
            "session_id", "seq", name=op.f("uq_observation_batches_session_id_seq")
        ),
    )
    op.create_index("ix_observation_batches_received_s", "observation_batches", ["received_s"])
    op.create_index(
        "ix_observation_batches_session_id_last_s", "observation_batches", ["session_id", "last_s"]
    )
    op.create_table(
        "snapshots",
        sa.Column("session_id", sa.String(), nullable=False),
        sa.Column("payload", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["session_id"],
            ["sessions.id"],
            name=op.f("fk_snapshots_session_id_sessions"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("session_id", name=op.f("pk_snapshots")),
    )


def _create_track_points() -> None:
    op.create_table(
        "track_points",
        sa.Column("session_id", sa.String(), nullable=False),
        sa.Column("time_us", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("time_s", EXACT_FLOAT, nullable=False),
        sa.Column("floor_id", sa.String(), nullable=False),
        sa.Column("x_m", EXACT_FLOAT, nullable=False),
        sa.Column("y_m", EXACT_FLOAT, nullable=False),
        sa.Column("covariance_xx_m2", EXACT_FLOAT, nullable=False),
        sa.Column("covariance_xy_m2", EXACT_FLOAT, nullable=False),
        sa.Column("covariance_yy_m2", EXACT_FLOAT, nullable=False),
        sa.Column("radius95_m", EXACT_FLOAT, nullable=False),
        sa.Column("speed_mps", EXACT_FLOAT, nullable=False),
        sa.Column("heading_rad", EXACT_FLOAT, nullable=True),
        sa.Column("motion", sa.String(), nullable=False),
        sa.Column("method", sa.String(), nullable=False),
        sa.Column("floor_confidence", EXACT_FLOAT, nullable=False),
        sa.Column("used_beacons", sa.Integer(), nullable=False),
        sa.Column("used_access_points", sa.Integer(), nullable=False),
        sa.Column("used_steps", sa.Integer(), nullable=False),
        sa.Column("age_s", EXACT_FLOAT, nullable=False),
        sa.Column("profile", sa.String(), nullable=False),
        sa.Column("zones", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint(
            ["session_id"],
            ["sessions.id"],
            name=op.f("fk_track_points_session_id_sessions"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("session_id", "time_us", name=op.f("pk_track_points")),
    )
    op.create_index("ix_track_points_floor_id_time_us", "track_points", ["floor_id", "time_us"])
