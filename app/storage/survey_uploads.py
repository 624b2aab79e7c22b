"""Uploads of surveys that are under way: what a restarted server must know to go on with them."""

from dataclasses import asdict, dataclass

from sqlalchemy import Connection, delete, insert, select, update

from app.storage.jobs import StoredJob, get_job, list_jobs_by_id
from app.storage.survey_tables import SURVEY_UPLOADS


@dataclass(frozen=True, slots=True)
class StoredUpload:
    """What an upload is of, beside its job.

    Attributes
    ----------
    total_bytes
        How long the file is; None while one that comes in one go has not ended.
    touched_s
        When something last came of it.
    interruptions
        How often the server ended while it was read.
    """

    job_id: str
    name: str
    floor_id: str | None
    total_bytes: int | None
    touched_s: float
    interruptions: int = 0


def put_upload(connection: Connection, upload: StoredUpload) -> bool:
    """Store how an upload stands now; False if its job is gone, as it is with its site."""
    if get_job(connection, upload.job_id) is None:
        return False
    values = asdict(upload)
    known = update(SURVEY_UPLOADS).where(SURVEY_UPLOADS.c.job_id == upload.job_id)
    if connection.execute(known.values(**values)).rowcount == 0:
        connection.execute(insert(SURVEY_UPLOADS).values(**values))
    return True


def delete_upload(connection: Connection, job_id: str) -> None:
    """Forget an upload; its job stays."""
    connection.execute(delete(SURVEY_UPLOADS).where(SURVEY_UPLOADS.c.job_id == job_id))


def list_uploads(connection: Connection) -> list[tuple[StoredJob, StoredUpload]]:
    """Return all uploads with their jobs, the oldest first."""
    query = select(SURVEY_UPLOADS).order_by(SURVEY_UPLOADS.c.touched_s)
    uploads = [StoredUpload(**row) for row in connection.execute(query).mappings()]
    by_id = list_jobs_by_id(connection, [upload.job_id for upload in uploads])
    return [(by_id[upload.job_id], upload) for upload in uploads]
