"""A lane of jobs: one at a time, in the order in which they were asked for."""

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import TypeAlias

from app.services.errors import AppError, ErrorCode
from app.services.jobs import JobBoard
from app.storage.database import DatabaseUnavailableError
from app.storage.jobs import StoredJob

_LOG = logging.getLogger(__name__)

Work: TypeAlias = Callable[[StoredJob], Awaitable[None]]
"""Does a job's work when its turn has come, and ends the job; if it cannot, it raises."""


class JobLane:
    """Runs jobs of one kind; one that fails says so and takes no other with it."""

    def __init__(self, board: JobBoard, kind: str) -> None:
        self._board = board
        self._kind = kind
        self._turn = asyncio.Lock()
        self._running: set[asyncio.Task[None]] = set()

    async def start(self, site_id: str, work: Work) -> StoredJob:
        """Begin a job and return it as it stands."""
        job = await self._board.open(self._kind, site_id, "waiting")
        task = asyncio.create_task(self._run(job, work))
        self._running.add(task)
        task.add_done_callback(self._running.discard)
        return job

    async def settle(self) -> None:
        """Wait until all jobs asked for by now have ended."""
        await asyncio.gather(*self._running)

    async def close(self) -> None:
        """Give up what has not ended; its jobs fail when the server starts again."""
        for task in self._running:
            task.cancel()
        await asyncio.gather(*self._running, return_exceptions=True)

    async def _run(self, job: StoredJob, work: Work) -> None:
        try:
            async with self._turn:
                await work(job)
        except AppError as error:
            ended = job.failed(error.code.value, str(error), self._board.now_s)
        except DatabaseUnavailableError as error:
            ended = job.failed(ErrorCode.UNAVAILABLE.value, str(error), self._board.now_s)
        except Exception:  # noqa: BLE001 - whoever asked must learn that it came to nothing
            _LOG.exception("a %s for site %r has failed", self._kind, job.site_id)
            detail = f"the {self._kind} has failed; see the server's log"
            ended = job.failed(ErrorCode.INTERNAL.value, detail, self._board.now_s)
        else:
            return
        await self._board.end(ended)
