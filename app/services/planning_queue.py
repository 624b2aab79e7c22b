"""Plans one at a time: they take a processor for seconds, and phones come first."""

import asyncio
from collections.abc import Callable
from typing import TypeVar

from app.services.errors import AppError, ErrorCode

Result = TypeVar("Result")

MAX_WAITING = 4
"""Most take a second, a search on a large floor half a minute; who comes later is told so."""


class PlanQueue:
    """Work that waits for its turn, then runs in a thread of its own."""

    def __init__(self) -> None:
        self._turn = asyncio.Semaphore(1)
        self._present = 0

    async def run(self, work: Callable[[], Result]) -> Result:
        """Return what ``work`` does, when its turn has come.

        Raises
        ------
        AppError
            If too many wait already.
        """
        if self._present > MAX_WAITING:
            detail = "too many plans are waiting; come back later"
            raise AppError(ErrorCode.TOO_MANY_REQUESTS, detail, retry_after_s=10)
        self._present += 1
        try:
            async with self._turn:
                return await asyncio.to_thread(work)
        finally:
            self._present -= 1
