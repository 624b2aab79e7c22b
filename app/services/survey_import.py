"""A received file becomes a stored survey, or nothing: another process parses it.

Its records are stored in strides, and hidden while they come in; the last transaction shows
the survey, and whatever ends the import before that removes them.
"""

import asyncio
import logging
import multiprocessing
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection
from uuid import uuid4

from sqlalchemy import Connection as SqlConnection

from app.services.jobs import JobBoard
from app.services.survey_parsing import (
    Message,
    Parsed,
    ParseTask,
    Progress,
    Refused,
    Rows,
    send_parsed,
)
from app.sessions.ports import Clock
from app.storage import surveys
from app.storage.database import Database, DatabaseUnavailableError
from app.storage.jobs import StoredJob
from app.storage.surveys import StoredSurvey

_LOG = logging.getLogger(__name__)


class SurveyImporter:
    """Imports one file after the other."""

    def __init__(self, database: Database, board: JobBoard, clock: Clock) -> None:
        self._database = database
        self._board = board
        self._clock = clock
        self._turn = asyncio.Semaphore(1)

    async def run(self, job: StoredJob, task: ParseTask, name: str) -> None:
        """Import a file and end its job, one way or the other."""
        try:
            async with self._turn:
                await self._import(replace(job, state="running"), task, name)
        except DatabaseUnavailableError as error:
            await self._fail(job, "unavailable", str(error))
        except Exception:  # noqa: BLE001 - whoever uploaded must learn that it came to nothing
            _LOG.exception("importing a survey of site %r has failed", job.site_id)
            await self._fail(job, "internal", "the import has failed; see the server's log")

    async def _import(self, job: StoredJob, task: ParseTask, name: str) -> None:
        survey = StoredSurvey(uuid4().hex[:12], job.site_id, name, "", self._clock.now_s())
        receiving, sending = multiprocessing.Pipe(duplex=False)
        process = multiprocessing.get_context("spawn").Process(
            target=send_parsed, args=(task, sending), daemon=True
        )
        await self._board.update(job)
        await self._database.write(lambda c: surveys.begin_survey(c, survey))
        complete = False
        try:
            await asyncio.to_thread(process.start)
            sending.close()
            complete = await self._take_all(job, survey, receiving)
        finally:
            process.kill()
            receiving.close()
            if not complete:
                self._database.submit(partial(_forget, survey.survey_id))

    async def _take_all(self, job: StoredJob, survey: StoredSurvey, receiving: Connection) -> bool:
        while True:
            message = await asyncio.to_thread(_next_message, receiving)
            match message:
                case Rows(rows):
                    await self._store(survey, rows)
                case Progress():
                    job = replace(job, progress=_with_progress(job, message))
                    await self._board.update(job)
                case Parsed():
                    await self._complete(job, survey, message)
                    return True
                case Refused(detail, unusable):
                    await self._fail(job, "nothing_usable", detail, unusable=unusable)
                    return False
                case None:
                    detail = "the process that read the file has died; it may lack memory"
                    await self._fail(job, "internal", detail)
                    return False

    async def _store(self, survey: StoredSurvey, rows: list[surveys.RecordRow]) -> None:
        if rows:
            await self._database.write(lambda c: surveys.add_records(c, survey.survey_id, rows))

    async def _complete(self, job: StoredJob, survey: StoredSurvey, parsed: Parsed) -> None:
        whole = replace(
            survey,
            survey_format="+".join(parsed.formats),
            device_model=parsed.device_model,
            holdings=parsed.holdings,
            unusable=parsed.unusable,
        )
        result = {
            "survey_id": whole.survey_id,
            "format": whole.survey_format,
            "unusable": parsed.unusable,
        }
        done = job.done(result, self._clock.now_s())

        def completing(connection: SqlConnection) -> StoredJob:
            surveys.complete_survey(connection, whole)
            return done

        # A job that had not ended would be begun again after a restart, and the survey be there
        # twice.
        await self._board.end_with(completing)

    async def _fail(self, job: StoredJob, code: str, detail: str, **more: object) -> None:
        await self._board.end(job.failed(code, detail, self._clock.now_s(), **more))


def _next_message(receiving: Connection) -> Message | None:
    """Wait for a message; None when the process is gone without a last one."""
    try:
        message: Message = receiving.recv()
    except EOFError:
        return None
    return message


def _with_progress(job: StoredJob, progress: Progress) -> dict[str, int]:
    return {
        **job.progress,
        "read_bytes": progress.read_bytes,
        "traces": progress.traces,
        "fingerprints": progress.fingerprints,
        "unusable": progress.unusable,
    }


def _forget(survey_id: str, connection: SqlConnection) -> None:
    surveys.delete_survey(connection, survey_id)
