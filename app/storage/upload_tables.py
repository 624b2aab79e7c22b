"""The table of uploads under way; `app.storage.tables` has it among all others."""

from sqlalchemy import BigInteger, Column, Double, ForeignKey, Integer, String, Table

from app.storage.columns import METADATA

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
