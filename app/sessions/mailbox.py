"""The mailbox: what is asked of one device is done in order, one thing at a time, to its end."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import TypeVar

from app.sessions.batch import MailboxFullError

Result = TypeVar("Result")


class Mailbox:
    """Runs the jobs of one device in the order of the calls, each to its end, caller or not."""

    def __init__(self, capacity: int, retry_after_s: float) -> None:
        self._capacity = capacity
        self._retry_after_s = retry_after_s
        self._turn = asyncio.Lock()
        self._jobs: set[asyncio.Task[object]] = set()

    @property
    def idle(self) -> bool:
        """Whether nothing runs or waits."""
        return not self._jobs

    async def offer(self, job: Callable[[], Awaitable[Result]]) -> Result:
        """Run a job from outside; raises `MailboxFullError` instead of queueing without bound."""
        if len(self._jobs) >= self._capacity:
            raise MailboxFullError(self._retry_after_s)
        return await self.run(job)

    async def run(self, job: Callable[[], Awaitable[Result]]) -> Result:
        """Run a job of our own, which is never refused."""
        return await asyncio.shield(self.post(job))

    def post(self, job: Callable[[], Awaitable[Result]]) -> "asyncio.Task[Result]":
        """Queue a job and return at once."""
        task = asyncio.create_task(self._in_turn(job))
        self._jobs.add(task)
        task.add_done_callback(self._jobs.discard)
        return task

    async def _in_turn(self, job: Callable[[], Awaitable[Result]]) -> Result:
        async with self._turn:
            return await job()
