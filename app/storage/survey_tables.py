"""The tables of surveys and of their uploads; `app.storage.tables` has them among all others."""

from sqlalchemy import (
    BigInteger,
    Boolean,
    CheckConstraint,
    Column,
    Double,
    ForeignKey,
    Integer,
    LargeBinary,
    String,
    Table,
    text,
)

from app.storage.columns import (
    JSON_OR_NULL,
    METADATA,
    ROW_ID,
    row_version_column,
    site_id_column,
)

# What a restarted server must know to go on with an upload.
SURVEY_UPLOADS = Table(
    "survey_uploads",
    METADATA,
    Column("job_id", String, ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
    Column("name", String, nullable=False),
    Column("floor_id", String),
    Column("total_bytes", BigInteger),
    Column("touched_s", Double, nullable=False),
    Column("interruptions", Integer, nullable=False),
)
SURVEYS = Table(
    "surveys",
    METADATA,
    Column("id", String, primary_key=True),
    site_id_column(),
    Column("name", String, nullable=False, server_default=""),
    # Name of the format it was uploaded in.
    Column("format", String, nullable=False),
    Column("device_id", String),
    Column("device_model", String),
    Column("created_s", Double, nullable=False),
    # Records come in strides; until the last one is there, nobody sees the survey.
    Column("complete", Boolean, nullable=False, server_default=text("false")),
    # What it holds per floor, see storage.surveys.Holding.
    Column("holdings", JSON_OR_NULL),
    # What of the upload could not be used: counts by reason, and the first places.
    Column("unusable", JSON_OR_NULL),
    row_version_column(),
)

SURVEY_RECORDS = Table(
    "survey_records",
    METADATA,
    Column("id", ROW_ID, primary_key=True),
    Column(
        "survey_id",
        String,
        ForeignKey("surveys.id", ondelete="CASCADE"),
        nullable=False,
        index=True,
    ),
    # No foreign key: a floor that is taken out and put back finds its survey again.
    Column("floor_id", String, nullable=False),
    Column("kind", String, nullable=False),
    # Name of the walk; of points the walk they belong to, if any.
    Column("walk", String, nullable=False, server_default=""),
    Column("first_s", Double),
    Column("last_s", Double),
    # One core.survey.SurveyWalk, or a few hundred SurveyPoints, encoded by storage.codec.
    Column("payload", LargeBinary, nullable=False),
    CheckConstraint("kind IN ('walk', 'points')", name="kind"),
)
