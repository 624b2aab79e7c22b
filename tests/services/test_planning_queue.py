"""One plan at a time; who would wait too long is told so."""

import asyncio
import threading

import pytest

from app.services.errors import AppError, ErrorCode
from app.services.planning_queue import MAX_WAITING, PlanQueue

pytestmark = pytest.mark.anyio


async def test_plans_run_one_after_the_other_and_a_full_queue_refuses() -> None:
    queue, go_on = PlanQueue(), threading.Event()
    running, most = 0, 0

    def work() -> str:
        nonlocal running, most
        running += 1
        most = max(most, running)
        go_on.wait(60.0)
        running -= 1
        return "done"

    waiting = [asyncio.create_task(queue.run(work)) for _ in range(MAX_WAITING + 1)]
    await asyncio.sleep(0)
    with pytest.raises(AppError) as refused:
        await queue.run(work)
    assert refused.value.code is ErrorCode.TOO_MANY_REQUESTS
    assert refused.value.retry_after_s
    go_on.set()
    assert await asyncio.gather(*waiting) == ["done"] * (MAX_WAITING + 1)
    assert most == 1
    assert await queue.run(lambda: "again") == "again"


async def test_a_plan_that_fails_makes_room_for_the_next() -> None:
    queue = PlanQueue()

    def failing() -> None:
        raise KeyError

    for _ in range(MAX_WAITING + 2):
        with pytest.raises(KeyError):
            await queue.run(failing)
    assert await queue.run(lambda: 1) == 1
