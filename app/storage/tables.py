"""The tables, the same on SQLite and PostgreSQL.

Times are seconds since the Unix epoch as 64-bit floats (``*_s``); ``time_us`` is the same instant
in whole microseconds where it serves as a key. ``row_version`` counts the edits of a row: its ETag.
"""

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    CheckConstraint,
    Column,
    Double,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    String,
    Table,
    UniqueConstraint,
    text,
)

import app.storage.survey_tables  # noqa: F401 - it adds its tables to METADATA
from app.storage.columns import (
    EXACT_FLOAT,
    JSON_OR_NULL,
    METADATA,
    ROW_ID,
    row_version_column,
    site_id_column,
)

SITES = Table(
    "sites",
    METADATA,
    Column("id", String, primary_key=True),
    Column("name", String, nullable=False),
    # How long scans, steps and tracks are kept; NULL: as long as the server's setting says.
    Column("retention_days", Double),
    Column("default_profile", String, nullable=False, server_default="best"),
    Column("georeference", JSON_OR_NULL),
    # Finished sessions are kept aside, so that an admin may let the radio map grow by them.
    Column("grow_map", Boolean, nullable=False, server_default=text("false")),
    Column("created_s", Double, nullable=False),
    # Counts the edits of all that the engine sees of the site: floors, maps, beacons, radio map.
    Column("model_version", Integer, nullable=False, server_default="1"),
    row_version_column(),
)

FLOORS = Table(
    "floors",
    METADATA,
    Column("id", String, primary_key=True),
    site_id_column(index=False),
    Column("name", String, nullable=False),
    Column("building", String, nullable=False, server_default=""),
    Column("ordinal", Integer, nullable=False),
    Column("x0_m", Double, nullable=False),
    Column("y0_m", Double, nullable=False),
    Column("width_m", Double, nullable=False),
    Column("height_m", Double, nullable=False),
    Column("plan_image", LargeBinary),
    Column("plan_media_type", String),
    # GeoJSON of walls and walkable area in the site frame.
    Column("map", JSON_OR_NULL),
    # A `core.geometry.Walkable`, encoded by storage.codec.
    Column("walkable", LargeBinary),
    Column("georeference", JSON_OR_NULL),
    row_version_column(),
    CheckConstraint("width_m > 0 AND height_m > 0", name="size"),
    UniqueConstraint("site_id", "building", "name"),
)

BEACONS = Table(
    "beacons",
    METADATA,
    Column("id", String, primary_key=True),
    site_id_column(),
    # A beacon that is registered but not placed yet has no floor and no position.
    Column("floor_id", String, ForeignKey("floors.id", ondelete="SET NULL"), index=True),
    Column("kind", String, nullable=False),
    Column("name", String, nullable=False, server_default=""),
    Column("x_m", Double),
    Column("y_m", Double),
    Column("z_m", Double, nullable=False, server_default="0"),
    Column("ref_level_dbm", Double, nullable=False),
    Column("ref_distance_m", Double, nullable=False),
    Column("path_loss_exponent", Double, nullable=False),
    Column("shadowing_db", Double, nullable=False),
    row_version_column(),
    CheckConstraint("kind IN ('ble', 'wifi')", name="kind"),
)

BEACON_KEYS = Table(
    "beacon_keys",
    METADATA,
    Column("site_id", String, ForeignKey("sites.id", ondelete="CASCADE"), primary_key=True),
    Column("key", String, primary_key=True),
    Column(
        "beacon_id",
        String,
        ForeignKey("beacons.id", ondelete="CASCADE"),
        nullable=False,
        index=True,
    ),
    # Order of the keys as registered, most specific first.
    Column("rank", Integer, nullable=False),
)

BEACON_HEALTH = Table(
    "beacon_health",
    METADATA,
    Column("beacon_id", String, ForeignKey("beacons.id", ondelete="CASCADE"), primary_key=True),
    # Event time of the newest reading.
    Column("last_heard_s", Double, nullable=False),
    # Event time of the newest telemetry; NULL: there was none.
    Column("told_s", Double),
    Column("battery_percent", Double),
    Column("battery_v", Double),
    Column("temperature_degc", Double),
)

CALIBRATIONS = Table(
    "calibrations",
    METADATA,
    Column("id", String, primary_key=True),
    site_id_column(),
    Column(
        "floor_id",
        String,
        ForeignKey("floors.id", ondelete="CASCADE"),
        nullable=False,
        index=True,
    ),
    Column("kind", String, nullable=False),
    Column("source", JSON, nullable=False),
    Column("report", JSON, nullable=False),
    # Columns of the beacons as they would be, and of which row version that was thought.
    Column("proposed", JSON, nullable=False),
    Column("offsets_db", JSON, nullable=False),
    Column("created_s", Double, nullable=False),
    # NULL: a draft.
    Column("applied_s", Double),
    row_version_column(),
    CheckConstraint("kind IN ('levels', 'places')", name="kind"),
)

DEVICES = Table(
    "devices",
    METADATA,
    # The phone's own name for itself.
    Column("id", String, primary_key=True),
    site_id_column(nullable=True),
    Column("name", String, nullable=False, server_default=""),
    Column("person", String),
    Column("platform", String),
    Column("model", String),
    Column("profile", String),
    # How much louder than others it hears; taken off every level it reports.
    Column("level_offset_db", Double, nullable=False, server_default="0"),
    Column("first_seen_s", Double),
    Column("last_seen_s", Double),
    row_version_column(),
)

TOKENS = Table(
    "tokens",
    METADATA,
    Column("id", String, primary_key=True),
    Column("token_hash", LargeBinary, nullable=False, unique=True),
    Column("role", String, nullable=False),
    # A token of a deleted site goes with it: it must not turn into a token for all sites.
    Column("site_id", String, ForeignKey("sites.id", ondelete="CASCADE"), index=True),
    Column("device_id", String),
    Column("device_prefix", String),
    Column("label", String, nullable=False, server_default=""),
    Column("created_s", Double, nullable=False),
    Column("expires_s", Double),
    Column("revoked_s", Double),
    CheckConstraint("role IN ('admin', 'supervisor', 'surveyor', 'viewer', 'device')", name="role"),
)

JOBS = Table(
    "jobs",
    METADATA,
    Column("id", String, primary_key=True),
    site_id_column(),
    # What it does: "survey import" and others.
    Column("kind", String, nullable=False),
    Column("state", String, nullable=False),
    # Numbers that grow while it runs; for a survey import bytes, traces, fingerprints.
    Column("progress", JSON, nullable=False),
    # What came of it: `result` when it is done, `problem` (code, detail) when it failed.
    Column("result", JSON_OR_NULL),
    Column("problem", JSON_OR_NULL),
    Column("created_s", Double, nullable=False),
    Column("ended_s", Double),
    CheckConstraint("state IN ('receiving', 'waiting', 'running', 'done', 'failed')", name="state"),
)

RADIO_MAPS = Table(
    "radio_maps",
    METADATA,
    Column("id", String, primary_key=True),
    site_id_column(index=False),
    Column("version", Integer, nullable=False),
    Column("active", Boolean, nullable=False, server_default=text("false")),
    Column("label", String, nullable=False, server_default=""),
    # Where it came from: survey ids, cleaning parameters.
    Column("provenance", JSON_OR_NULL),
    Column("fingerprints", Integer, nullable=False),
    Column("transmitters", Integer, nullable=False),
    Column("created_s", Double, nullable=False),
    # A `core.fingerprint.radio_map.RadioMap`, encoded by storage.codec.
    Column("payload", LargeBinary, nullable=False),
    # Counts the activations of a site: the highest is the active map's, the next lower that of the
    # one before. NULL: never active, or taken back.
    Column("activation", Integer),
    # A `core.fingerprint.cleaning.LevelStatistics`, encoded by storage.codec.
    Column("statistics", LargeBinary),
    UniqueConstraint("site_id", "version"),
    Index(
        "uq_radio_maps_active",
        "site_id",
        unique=True,
        sqlite_where=text("active"),
        postgresql_where=text("active"),
    ),
)

AGED_TRANSMITTERS = Table(
    "aged_transmitters",
    METADATA,
    Column(
        "radio_map_id", String, ForeignKey("radio_maps.id", ondelete="CASCADE"), primary_key=True
    ),
    Column("key", String, primary_key=True),
    Column("change", String, nullable=False),
    # 0 where a transmitter was quarantined before these were told.
    Column("excess", Double, nullable=False, server_default=text("0")),
    Column("scans", Integer, nullable=False),
    Column("misplaced", Integer, nullable=False, server_default=text("0")),
    Column("expected", Double, nullable=False),
    Column("found_s", Double, nullable=False),
    # Left out of matching; an admin's word outlives the next look at traffic.
    Column("quarantined", Boolean, nullable=False, server_default=text("false")),
)

SESSIONS = Table(
    "sessions",
    METADATA,
    Column("id", String, primary_key=True),
    Column("device_id", String, ForeignKey("devices.id", ondelete="CASCADE"), nullable=False),
    # The phone's name for the session.
    Column("session", String, nullable=False),
    site_id_column(),
    Column("profile", String, nullable=False),
    # The phone named the profile: it does not follow when its device or site gets another one.
    Column("profile_named", Boolean, nullable=False, server_default=text("false")),
    # Event time since which the profile is on; NULL: always.
    Column("profile_since_s", EXACT_FLOAT),
    Column("clock_recorded", Boolean, nullable=False),
    Column("clock_mono_to_wall_s", Double),
    Column("clock_boot_id", String),
    Column("opened_s", Double, nullable=False),
    Column("finished", Boolean, nullable=False, server_default=text("false")),
    # How far the server is ahead of the phone's wall and monotonic clocks; NULL: not told.
    Column("clock_ahead_s", Double),
    Column("clock_mono_ahead_s", Double),
    # Of the batch that told clock_mono_to_wall_s; -1: it was frozen by an earlier release.
    Column("clock_mono_seq", BigInteger),
    UniqueConstraint("device_id", "session"),
)


def _session_key() -> Column[str]:
    return Column(
        "session_id", String, ForeignKey("sessions.id", ondelete="CASCADE"), primary_key=True
    )


OBSERVATION_BATCHES = Table(
    "observation_batches",
    METADATA,
    Column("id", ROW_ID, primary_key=True),
    Column("session_id", String, ForeignKey("sessions.id", ondelete="CASCADE"), nullable=False),
    Column("seq", BigInteger, nullable=False),
    Column("digest", LargeBinary, nullable=False),
    Column("received_s", Double, nullable=False),
    # Event times of the first and last instant the batch speaks of; NULL when it holds nothing.
    Column("first_s", Double),
    Column("last_s", Double),
    # Lets retention find what it must rewrite without decoding everything.
    Column("has_imu", Boolean, nullable=False),
    Column("payload", LargeBinary, nullable=False),
    Column("rejected", LargeBinary, nullable=False),
    Column("ignored", Integer, nullable=False),
    # For each observation whether the monotonic clock timed it, a byte each; empty: none. NULL: the
    # payload is in event time, as an earlier release wrote it.
    Column("monotonic", LargeBinary),
    UniqueConstraint("session_id", "seq"),
    Index("ix_observation_batches_session_id_last_s", "session_id", "last_s"),
    Index("ix_observation_batches_received_s", "received_s"),
)

SNAPSHOTS = Table(
    "snapshots",
    METADATA,
    _session_key(),
    # With which it was folded: for another profile it is of no use.
    Column("profile", String, nullable=False, server_default=""),
    Column("payload", LargeBinary, nullable=False),
)

TRACK_POINTS = Table(
    "track_points",
    METADATA,
    _session_key(),
    Column("time_us", BigInteger, primary_key=True, autoincrement=False),
    Column("time_s", EXACT_FLOAT, nullable=False),
    # No foreign key: what was recorded on a floor outlives the floor's removal from the registry.
    Column("floor_id", String, nullable=False),
    Column("x_m", EXACT_FLOAT, nullable=False),
    Column("y_m", EXACT_FLOAT, nullable=False),
    Column("covariance_xx_m2", EXACT_FLOAT, nullable=False),
    Column("covariance_xy_m2", EXACT_FLOAT, nullable=False),
    Column("covariance_yy_m2", EXACT_FLOAT, nullable=False),
    Column("radius95_m", EXACT_FLOAT, nullable=False),
    Column("speed_mps", EXACT_FLOAT, nullable=False),
    Column("heading_rad", EXACT_FLOAT),
    Column("motion", String, nullable=False),
    Column("method", String, nullable=False),
    Column("floor_confidence", EXACT_FLOAT, nullable=False),
    Column("used_beacons", Integer, nullable=False),
    Column("used_access_points", Integer, nullable=False),
    Column("used_steps", Integer, nullable=False),
    Column("age_s", EXACT_FLOAT, nullable=False),
    Column("profile", String, nullable=False),
    Column("zones", JSON, nullable=False),
    Index("ix_track_points_floor_id_time_us", "floor_id", "time_us"),
)

QUARANTINED_SESSIONS = Table(
    "quarantined_sessions",
    METADATA,
    # With the session, and so with its device, what was learned from it is forgotten.
    _session_key(),
    site_id_column(),
    Column("collected_s", Double, nullable=False),
    # NULL once accepted or discarded: what is left says that the session is not to be taken again.
    Column("decided_s", Double),
    # Observations without raw inertial samples, encoded by storage.codec; empty once decided.
    Column("payload", LargeBinary, nullable=False),
)
