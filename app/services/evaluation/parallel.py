"""Work spread over all cores, in fresh processes."""

import math
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

_CHUNK = 4


def on_all_cores(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    begin: Callable[..., None] | None = None,
    begin_with: tuple[Any, ...] = (),
    chunk: int = _CHUNK,
) -> Iterator[Result]:
    """Yield the results of work in the order of the items.

    Each process first calls ``begin(*begin_with)`` and is handed ``chunk`` items at a time.
    """
    # Fresh interpreters: a fork would copy a progress display's thread half-way.
    context = multiprocessing.get_context("spawn")
    workers = max(min(os.cpu_count() or 1, math.ceil(len(items) / chunk)), 1)
    with ProcessPoolExecutor(workers, context, begin, begin_with) as pool:
        yield from pool.map(work, items, chunksize=chunk)
