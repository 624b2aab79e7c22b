"""Edits of stored surveys."""

from collections.abc import Callable

from sqlalchemy import Connection

from app.services.errors import found
from app.services.writing import SeenVersions, check_seen, write
from app.storage import surveys
from app.storage.database import Database
from app.storage.surveys import StoredSurvey


async def rename_survey(
    database: Database, survey_id: str, seen: SeenVersions, renamed: Callable[[str], str]
) -> StoredSurvey:
    """Give a survey the name that ``renamed`` makes of the one it has."""

    def statement(connection: Connection) -> StoredSurvey:
        stored = found(surveys.get_survey(connection, survey_id), "survey", survey_id)
        check_seen(seen, stored.row_version, "the survey")
        return surveys.rename_survey(connection, stored, renamed(stored.name))

    return await write(database, statement)
