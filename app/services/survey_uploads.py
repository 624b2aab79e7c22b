"""Uploads of surveys: received into files of our own naming, in one go or in pieces.

An upload is a job from its first byte on. One that breaks off keeps what has arrived, and is
continued at that offset, by another server process too: file, job and what it is of are stored.
"""

import asyncio
import logging
from collections.abc import AsyncIterable
from dataclasses import dataclass, field, replace
from functools import partial

from app.formats.survey_places import SurveyFrame
from app.services.errors import AppError, ErrorCode, not_found
from app.services.jobs import SERVER_STOPPED, JobBoard
from app.services.survey_frames import UploadRequest, survey_frame
from app.services.survey_import import SurveyImporter
from app.services.survey_parsing import PROGRESS_STEPS, ParseTask
from app.services.survey_spool import Spool, to_disk
from app.storage import survey_uploads, surveys
from app.storage.database import Database, DatabaseUnavailableError
from app.storage.jobs import StoredJob
from app.storage.survey_uploads import StoredUpload

_LOG = logging.getLogger(__name__)

MAX_OPEN = 8
"""Each may take a gigabyte of disk; an admin has one or two."""
IDLE_S = 24 * 3600.0
"""Who has not continued a day later has begun another one."""
ORPHAN_S = 2.0 * IDLE_S
"""Nobody goes on with a file that nothing was written to for so long."""
SWEEP_S = 3600.0
MAX_INTERRUPTIONS = 3
"""A file whose reading ends the server (it takes all memory, say) must not end it for ever."""
KIND = "survey import"


@dataclass(slots=True)
class _Upload:
    job: StoredJob
    request: UploadRequest
    frame: SurveyFrame
    touched_s: float
    received: int = 0
    interruptions: int = 0
    receiving: asyncio.Lock = field(default_factory=asyncio.Lock)

    def stored(self) -> StoredUpload:
        return StoredUpload(
            job_id=self.job.job_id,
            name=self.request.name,
            floor_id=self.request.floor_id,
            total_bytes=self.request.total_bytes,
            touched_s=self.touched_s,
            interruptions=self.interruptions,
        )


class SurveyUploads:
    """Receives files and hands them to the importer."""

    def __init__(
        self,
        database: Database,
        board: JobBoard,
        importer: SurveyImporter,
        spool: Spool,
        limit: int,
    ) -> None:
        self.limit_bytes = limit
        self._database = database
        self._board = board
        self._importer = importer
        self.spool = spool
        self._uploads: dict[str, _Upload] = {}
        self._imports: dict[str, asyncio.Task[None]] = {}
        self._beginning = asyncio.Lock()

    async def recover(self) -> None:
        """At the start: go on with what was received, fail what the server's end cut off."""
        await self._database.write(surveys.delete_incomplete)
        kept = await self._database.read(survey_uploads.list_uploads)
        await self._board.fail_cut_off(but=[job.job_id for job, _ in kept])
        for job, stored in kept:
            size = await asyncio.to_thread(self.spool.size, job.job_id)
            await self._take_up(job, stored, size)
        await self.sweep()

    async def receive(self, request: UploadRequest, pieces: AsyncIterable[bytes]) -> StoredJob:
        """Take a file that comes in one go; if it breaks off, its job fails: it cannot go on."""
        job = await self.begin(request)
        try:
            await self.append(job.job_id, 0, pieces)
            return await self.finish(job.job_id)
        except AppError as error:
            await self.abandon(job.job_id, str(error))
            raise
        finally:
            # Of a full disk, say: nobody knows the job's id, who could give it up.
            await self.abandon(job.job_id, "the server could not store it")

    async def begin(self, request: UploadRequest) -> StoredJob:
        """Open an upload."""
        # One after the other: several at once would all find the last place free.
        async with self._beginning:
            return await self._begin(request)

    async def _begin(self, request: UploadRequest) -> StoredJob:
        await self.sweep()
        if len(self._uploads) + len(self._imports) >= MAX_OPEN:
            detail = f"{MAX_OPEN} uploads are open or waiting; finish or delete one first"
            raise AppError(ErrorCode.TOO_MANY_REQUESTS, detail, retry_after_s=30)
        if (request.total_bytes or 0) > self.limit_bytes:
            raise _too_large(self.limit_bytes)
        frame = await self._database.read(partial(survey_frame, request=request))
        job = await self._board.open(KIND, request.site_id, "receiving")
        job = replace(job, progress={"total_bytes": request.total_bytes or 0, "received_bytes": 0})
        await asyncio.to_thread(self.spool.begin, job.job_id)
        upload = _Upload(job, request, frame, self._board.now_s)
        self._uploads[job.job_id] = upload
        await self._tell(upload)
        return job

    async def append(self, job_id: str, offset: int, pieces: AsyncIterable[bytes]) -> StoredJob:
        """Add what comes; what has arrived when ``pieces`` raises stays.

        Returns the job as it is then; with the last byte it waits for its import.
        """
        upload = self._idle(job_id)
        async with upload.receiving:
            if offset != upload.received:
                detail = f"the upload continues at offset {upload.received}"
                headers = {"Upload-Offset": str(upload.received)}
                raise AppError(ErrorCode.CONFLICT, detail, headers=headers)
            try:
                await self._receive(upload, pieces)
            finally:
                upload.touched_s = self._board.now_s
                await self._tell(upload)
            if upload.received == upload.request.total_bytes:
                await self.finish(job_id)
        return upload.job

    async def finish(self, job_id: str) -> StoredJob:
        """Take the upload as whole and let it be imported."""
        upload = self._open(job_id)
        upload.request = replace(upload.request, total_bytes=upload.received)
        progress = {**upload.job.progress, "total_bytes": upload.received}
        upload.job = replace(upload.job, state="waiting", progress=progress)
        await self._tell(upload)
        del self._uploads[job_id]
        task = asyncio.create_task(self._import(upload))
        self._imports[job_id] = task
        task.add_done_callback(lambda _: self._imports.pop(job_id))
        return upload.job

    async def give_up(self, job_id: str) -> None:
        """Forget an upload that its sender does not want to go on with."""
        self._idle(job_id)
        await self.abandon(job_id, "it was deleted")

    async def abandon(self, job_id: str, detail: str) -> None:
        """Fail an upload that came to nothing."""
        upload = self._uploads.pop(job_id, None)
        if upload is not None:
            ended = upload.job.failed("upload_abandoned", detail, self._board.now_s)
            await self._board.end(ended)
            await self._forget(job_id)

    async def settle(self) -> None:
        """Wait until all that was received by now is read, and its files are gone."""
        await asyncio.gather(*self._imports.values())

    async def close(self) -> None:
        """Stop the imports: the server goes down, the next one begins them again."""
        tasks = tuple(self._imports.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def sweep(self) -> None:
        """Forget uploads that nobody goes on with, and files that belong to none."""
        before_s = self._board.now_s - IDLE_S
        for job_id, upload in list(self._uploads.items()):
            if upload.touched_s < before_s and not upload.receiving.locked():
                await self.abandon(job_id, "nothing came for a day")
        known = {*self._uploads, *self._imports}
        orphaned_s = self._board.now_s - ORPHAN_S
        await asyncio.to_thread(self.spool.drop_orphans, known, orphaned_s)

    async def sweep_on(self) -> None:
        """Sweep every hour, until cancelled."""
        while True:
            await asyncio.sleep(SWEEP_S)
            try:
                await self.sweep()
            except (DatabaseUnavailableError, OSError) as error:
                _LOG.warning("idle uploads are looked for later: %s", error)

    def site_of(self, job_id: str) -> str:
        """Return the site of an open upload."""
        return self._open(job_id).request.site_id

    async def _take_up(self, job: StoredJob, stored: StoredUpload, size: int | None) -> None:
        """Go on with an upload of a server that has ended, or say why that cannot be."""
        if job.ended:
            await self._forget(job.job_id)
            return
        interruptions = stored.interruptions + (job.state == "running")
        why_not = _lost(job, stored, size) or _too_often(interruptions)
        received = min(size or 0, job.progress.get("received_bytes", 0))
        request = UploadRequest(job.site_id, stored.name, stored.floor_id, stored.total_bytes)
        try:
            frame = await self._database.read(partial(survey_frame, request=request))
        except AppError as error:
            why_not = str(error)
        if why_not is not None:
            await self._board.end(job.failed(SERVER_STOPPED, why_not, self._board.now_s))
            await self._forget(job.job_id)
            return
        await asyncio.to_thread(self.spool.cut, job.job_id, received)
        progress = {"total_bytes": stored.total_bytes or 0, "received_bytes": received}
        job = replace(job, state="receiving", progress=progress)
        upload = _Upload(job, request, frame, stored.touched_s, received, interruptions)
        self._uploads[job.job_id] = upload
        await self._tell(upload)
        if received == stored.total_bytes:
            await self.finish(job.job_id)

    async def _import(self, upload: _Upload) -> None:
        job, name = upload.job, upload.request.name
        task = ParseTask(self.spool.path(job.job_id), name, upload.frame)
        try:
            await self._importer.run(job, task, name)
        except asyncio.CancelledError:
            # Told to stop, it was not interrupted: the next server reads the file from its start.
            await self._board.update(job)
            raise
        await self._forget(job.job_id)

    async def _forget(self, job_id: str) -> None:
        await asyncio.to_thread(self.spool.drop, job_id)
        self._database.submit(lambda c: survey_uploads.delete_upload(c, job_id))

    async def _receive(self, upload: _Upload, pieces: AsyncIterable[bytes]) -> None:
        limit = upload.request.total_bytes or self.limit_bytes
        step = limit // PROGRESS_STEPS
        with self.spool.appending(upload.job.job_id, upload.received) as file:
            async for piece in pieces:
                if upload.received + len(piece) > limit:
                    raise _too_large(limit)
                await asyncio.to_thread(file.write, piece)
                upload.received += len(piece)
                if upload.received - upload.job.progress["received_bytes"] > step:
                    await asyncio.to_thread(to_disk, file)
                    upload.touched_s = self._board.now_s
                    await self._tell(upload)

    async def _tell(self, upload: _Upload) -> None:
        """Store and tell how an upload stands: never more bytes than are on the disk."""
        progress = {**upload.job.progress, "received_bytes": upload.received}
        upload.job = replace(upload.job, progress=progress)
        stored = upload.stored()
        if not await self._database.write(lambda c: survey_uploads.put_upload(c, stored)):
            await self.abandon(upload.job.job_id, "its site was deleted")
            what = "site"
            raise not_found(what, upload.request.site_id)
        await self._board.update(upload.job)

    def _open(self, job_id: str) -> _Upload:
        upload = self._uploads.get(job_id)
        if upload is None:
            what = "open upload"
            raise not_found(what, job_id)
        return upload

    def _idle(self, job_id: str) -> _Upload:
        upload = self._open(job_id)
        if upload.receiving.locked():
            detail = "another request is sending this upload now"
            raise AppError(ErrorCode.CONFLICT, detail)
        return upload


def _lost(job: StoredJob, stored: StoredUpload, size: int | None) -> str | None:
    """Return why an upload cannot go on after a restart; None if it can."""
    if stored.total_bytes is None:
        return "the server was stopped while the file came in one go; send it again"
    told = job.progress.get("received_bytes", 0)
    if size is None or size < told:
        return "the server was stopped, and what it had received is gone; send it again"
    return None


def _too_often(interruptions: int) -> str | None:
    if interruptions < MAX_INTERRUPTIONS:
        return None
    return (
        f"the server was stopped {interruptions} times while it read the file; nothing was stored"
    )


def _too_large(limit_bytes: int) -> AppError:
    detail = f"the upload is longer than {limit_bytes} bytes"
    return AppError(ErrorCode.BODY_TOO_LARGE, detail)
