"""Uploads of surveys: received into files of our own naming, in one go or in pieces.

An upload is a job from its first byte on. One that breaks off keeps what has arrived, and is
continued at that offset.
"""

import asyncio
from collections.abc import AsyncIterable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from sqlalchemy import Connection

from app.formats.survey_places import SurveyFloor, SurveyFrame
from app.services.errors import AppError, ErrorCode, found, invalid_field, not_found
from app.services.jobs import JobBoard
from app.services.site import stored_georeference
from app.services.survey_import import SurveyImporter
from app.services.survey_parsing import PROGRESS_STEPS, ParseTask
from app.storage import floors, sites, surveys
from app.storage.database import Database
from app.storage.jobs import StoredJob

MAX_OPEN = 8
"""Each may take a gigabyte of disk; an admin has one or two."""
IDLE_S = 24 * 3600.0
"""Who has not continued a day later has begun another one."""
KIND = "survey import"


@dataclass(frozen=True, slots=True)
class UploadRequest:
    """What an upload is of.

    Attributes
    ----------
    floor_id
        The floor of all of it; None: what its records say.
    total_bytes
        How long the file is; None for one that comes in one go.
    """

    site_id: str
    name: str
    floor_id: str | None = None
    total_bytes: int | None = None


@dataclass(slots=True)
class _Upload:
    job: StoredJob
    request: UploadRequest
    frame: SurveyFrame
    path: Path
    touched_s: float
    received: int = 0
    receiving: asyncio.Lock = field(default_factory=asyncio.Lock)


class SurveyUploads:
    """Receives files and hands them to the importer."""

    def __init__(
        self, database: Database, board: JobBoard, importer: SurveyImporter, spool: Path, limit: int
    ) -> None:
        self.limit_bytes = limit
        self._database = database
        self._board = board
        self._importer = importer
        self.spool = spool
        self._uploads: dict[str, _Upload] = {}
        self._imports: set[asyncio.Task[None]] = set()

    async def clean_up(self) -> None:
        """At the start: fail and forget what the end of the server cut off."""
        await self._board.fail_cut_off()
        await self._database.write(surveys.delete_incomplete)

    async def begin(self, request: UploadRequest) -> StoredJob:
        """Open an upload."""
        await self._forget_idle()
        if len(self._uploads) + len(self._imports) >= MAX_OPEN:
            detail = f"{MAX_OPEN} uploads are open or waiting; finish one first"
            raise AppError(ErrorCode.TOO_MANY_REQUESTS, detail, retry_after_s=30)
        if (request.total_bytes or 0) > self.limit_bytes:
            raise _too_large(self.limit_bytes)
        frame = await self._database.read(partial(survey_frame, request=request))
        job = await self._board.open(KIND, request.site_id, "receiving")
        job = replace(job, progress={"total_bytes": request.total_bytes or 0, "received_bytes": 0})
        path = self.spool / job.job_id
        await asyncio.to_thread(path.touch)
        self._uploads[job.job_id] = _Upload(job, request, frame, path, self._board.now_s)
        await self._board.update(job)
        return job

    async def append(self, job_id: str, offset: int, pieces: AsyncIterable[bytes]) -> StoredJob:
        """Add what comes; what has arrived when ``pieces`` raises stays.

        Returns the job as it is then; with the last byte it waits for its import.
        """
        upload = self._open(job_id)
        if upload.receiving.locked():
            detail = "another request is sending this upload now"
            raise AppError(ErrorCode.CONFLICT, detail)
        async with upload.receiving:
            if offset != upload.received:
                detail = f"the upload continues at offset {upload.received}"
                headers = {"Upload-Offset": str(upload.received)}
                raise AppError(ErrorCode.CONFLICT, detail, headers=headers)
            try:
                await self._receive(upload, pieces)
            finally:
                await self._tell_received(upload)
        if upload.received == upload.request.total_bytes:
            return await self.finish(job_id)
        return upload.job

    async def finish(self, job_id: str) -> StoredJob:
        """Take the upload as whole and let it be imported."""
        upload = self._uploads.pop(job_id)
        progress = {**upload.job.progress, "total_bytes": upload.received}
        job = replace(upload.job, state="waiting", progress=progress)
        await self._board.update(job)
        task = asyncio.create_task(self._import(upload, job))
        self._imports.add(task)
        task.add_done_callback(self._imports.discard)
        return job

    async def abandon(self, job_id: str, detail: str) -> None:
        """Fail an upload that came to nothing."""
        upload = self._uploads.pop(job_id, None)
        if upload is not None:
            await asyncio.to_thread(upload.path.unlink, missing_ok=True)
            await self._board.update(
                upload.job.failed("upload_abandoned", detail, self._board.now_s)
            )

    async def close(self) -> None:
        """Stop the imports: the server goes down."""
        for task in self._imports:
            task.cancel()
        await asyncio.gather(*self._imports, return_exceptions=True)

    async def _import(self, upload: _Upload, job: StoredJob) -> None:
        name = upload.request.name
        try:
            await self._importer.run(job, ParseTask(upload.path, name, upload.frame), name)
        finally:
            await asyncio.to_thread(upload.path.unlink, missing_ok=True)

    async def _receive(self, upload: _Upload, pieces: AsyncIterable[bytes]) -> None:
        limit = upload.request.total_bytes or self.limit_bytes
        step = limit // PROGRESS_STEPS
        with upload.path.open("r+b") as file:
            file.seek(upload.received)
            async for piece in pieces:
                if upload.received + len(piece) > limit:
                    raise _too_large(limit)
                await asyncio.to_thread(file.write, piece)
                upload.received += len(piece)
                if upload.received - upload.job.progress["received_bytes"] > step:
                    file.flush()
                    await self._tell_received(upload)

    async def _tell_received(self, upload: _Upload) -> None:
        upload.touched_s = self._board.now_s
        progress = {**upload.job.progress, "received_bytes": upload.received}
        upload.job = replace(upload.job, progress=progress)
        await self._board.update(upload.job)

    async def _forget_idle(self) -> None:
        before_s = self._board.now_s - IDLE_S
        for job_id, upload in list(self._uploads.items()):
            if upload.touched_s < before_s and not upload.receiving.locked():
                await self.abandon(job_id, "nothing came for a day")

    def is_receiving(self, job_id: str) -> bool:
        """Tell whether a request is sending bytes of an upload now."""
        return self._open(job_id).receiving.locked()

    def _open(self, job_id: str) -> _Upload:
        upload = self._uploads.get(job_id)
        if upload is None:
            what = "open upload"
            raise not_found(what, job_id)
        return upload

    def site_of(self, job_id: str) -> str:
        """Return the site of an open upload."""
        return self._open(job_id).request.site_id


def _too_large(limit_bytes: int) -> AppError:
    detail = f"the upload is longer than {limit_bytes} bytes"
    return AppError(ErrorCode.BODY_TOO_LARGE, detail)


def survey_frame(connection: Connection, request: UploadRequest) -> SurveyFrame:
    """Return the site's frame as records are read in it."""
    site = found(sites.get_site(connection, request.site_id), "site", request.site_id)
    known = tuple(
        SurveyFloor(
            floor_id=floor.floor_id,
            name=floor.name,
            building=floor.building,
            ordinal=floor.ordinal,
            x0_m=floor.x0_m,
            y0_m=floor.y0_m,
            width_m=floor.width_m,
            height_m=floor.height_m,
        )
        for floor in floors.floors_of_site(connection, request.site_id)
    )
    if not known:
        pointer, detail = "#/site_id", f"site {request.site_id!r} has no floors yet"
        raise invalid_field(pointer, detail)
    chosen = request.floor_id
    if chosen is not None and chosen not in {floor.floor_id for floor in known}:
        pointer, detail = "#/floor_id", f"site {request.site_id!r} has no floor {chosen!r}"
        raise invalid_field(pointer, detail)
    return SurveyFrame(known, stored_georeference(site), chosen)
