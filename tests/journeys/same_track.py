"""One walk, posted in every way that a phone may post it, leaves one track."""

from collections.abc import Sequence
from typing import Any

from posting import (
    by_monotonic_clock,
    by_second,
    header,
    in_chunks,
    neighbours_swapped,
    numbered,
    post,
    post_over_websocket,
    post_through_a_crash,
    stored_track,
)
from server_process import ServerProcess

from app.core.types import Observation

WAYS = (
    *("over_websocket", "in_small_batches", "in_large_batches", "each_batch_twice"),
    *("neighbours_swapped", "through_a_crash"),
    *("monotonic_neighbours_swapped", "clock_told_once_second_through_a_crash"),
)


def reference_track(
    server: ServerProcess, site_id: str, observations: Sequence[Observation]
) -> list[dict[str, Any]]:
    """Return the track of the walk posted in the plainest way: each second over HTTP, in order."""
    with server.client() as client:
        for batch in numbered(header("plain", site_id), by_second(observations)):
            post(client, batch)
        return stored_track(client, "plain")


def track_posted(
    way: str, server: ServerProcess, site_id: str, observations: Sequence[Observation]
) -> list[dict[str, Any]]:
    """Return the track of the walk posted in one of `WAYS`, by a device of its own."""
    groups = {
        "in_small_batches": in_chunks(observations, 3),
        "in_large_batches": in_chunks(observations, 40),
    }.get(way) or by_second(observations)
    batches = numbered(header(way, site_id), groups)
    if way == "over_websocket":
        post_over_websocket(server, batches)
    elif way == "through_a_crash":
        post_through_a_crash(server, batches)
    elif way == "clock_told_once_second_through_a_crash":
        batches = by_monotonic_clock(header(way, site_id), batches, tell_clocks=[0])
        # What waits for the clock is acknowledged, then the server is killed.
        post_through_a_crash(server, [batches[1], batches[0], *batches[2:]], middle=1)
    else:
        if way == "monotonic_neighbours_swapped":
            seqs = range(len(batches))
            batches = by_monotonic_clock(header(way, site_id), batches, tell_clocks=seqs)
        with server.client() as client:
            swapped = way.endswith("neighbours_swapped")
            for batch in neighbours_swapped(batches) if swapped else batches:
                post(client, batch)
                if way == "each_batch_twice":
                    assert post(client, batch)["duplicate"]
    with server.client() as client:
        return stored_track(client, way)
