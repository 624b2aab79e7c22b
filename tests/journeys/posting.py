"""The ways in which one walk may reach the server, and the track that it leaves there."""

import gzip
import json
import math
import threading
from collections.abc import Collection, Sequence
from typing import Any

import httpx
from server_process import ServerProcess
from websockets.sync.client import connect

from app.core.types import Observation
from app.formats.ingest_body import ingest_body

Batch = tuple[int, bytes]
"""A sequence number and the body that is sent under it, always the same bytes."""

BOOTED_BEFORE_MS = 86_400_123
"""How long before its first record the phone's monotonic clock began to count."""


def header(device_id: str, site_id: str) -> dict[str, Any]:
    return {
        "device": {"id": device_id},
        "session": f"walk-of-{device_id}",
        "site": site_id,
        "clock": {"mode": "recorded"},
    }


def by_second(observations: Sequence[Observation]) -> list[list[Observation]]:
    """Return an app's usual batches: what was observed in each whole event second."""
    groups: dict[int, list[Observation]] = {}
    for observation in observations:
        groups.setdefault(math.floor(observation.time_s), []).append(observation)
    return [groups[second] for second in sorted(groups)]


def in_chunks(observations: Sequence[Observation], size: int) -> list[list[Observation]]:
    return [list(observations[i : i + size]) for i in range(0, len(observations), size)]


def numbered(shared: dict[str, Any], groups: Sequence[Sequence[Observation]]) -> list[Batch]:
    return [(seq, ingest_body(shared, seq, group)) for seq, group in enumerate(groups)]


def by_monotonic_clock(
    shared: dict[str, Any], batches: Sequence[Batch], tell_clocks: Collection[int]
) -> list[Batch]:
    """Return the batches timed by the phone's monotonic clock, of which those of some seqs tell.

    Between its two readings a few milliseconds pass, as many as the seq is; none in the first.
    """
    timed = []
    booted_ms = math.floor(_first_ms(batches)) - BOOTED_BEFORE_MS
    for seq, body in batches:
        document = json.loads(body)
        for record in document["records"]:
            for name in ("t_ms", "t0_ms", "t1_ms"):
                if name in record:
                    own_ms = round(record.pop(name) - booted_ms, 3)
                    record[name.replace("t", "mono", 1)] = own_ms
        told = {"sent_ms": booted_ms + 1e6 + seq, "mono_ms": 1e6} if seq in tell_clocks else {}
        document["clock"] = {**shared["clock"], **told}
        timed.append((seq, json.dumps(document).encode()))
    return timed


def _first_ms(batches: Sequence[Batch]) -> float:
    (record, *_) = json.loads(batches[0][1])["records"]
    return float(record.get("t_ms", record.get("t0_ms")))


def neighbours_swapped(batches: Sequence[Batch]) -> list[Batch]:
    swapped = list(batches)
    for i in range(0, len(swapped) - 1, 2):
        swapped[i], swapped[i + 1] = swapped[i + 1], swapped[i]
    return swapped


def post(client: httpx.Client, batch: Batch) -> dict[str, Any]:
    headers = {"Content-Type": "application/json", "Content-Encoding": "gzip"}
    reply = client.post("/v1/ingest", content=gzip.compress(batch[1], 1), headers=headers)
    assert reply.status_code == 200, reply.text
    answer: dict[str, Any] = reply.json()
    assert not answer["rejected"]
    return answer


def post_over_websocket(server: ServerProcess, batches: Sequence[Batch]) -> None:
    url = server.url.replace("http", "ws") + "/v1/ingest/stream"
    with connect(url, additional_headers=server.headers) as socket:
        for seq, body in batches:
            socket.send(body.decode())
            frame = json.loads(socket.recv())
            assert (frame["op"], frame["seq"]) == ("ack", seq), frame


def post_through_a_crash(
    server: ServerProcess, batches: Sequence[Batch], middle: int | None = None
) -> None:
    """Post; in the middle kill the server while a batch is on its way, start it, go on from there.

    The batch on its way was not acknowledged (or the phone did not hear it): it is sent again.
    """
    middle = len(batches) // 2 if middle is None else middle
    with server.client() as client:
        for batch in batches[:middle]:
            post(client, batch)
        on_its_way = threading.Thread(target=_post_unheard, args=(server, batches[middle]))
        on_its_way.start()
        server.kill()
        on_its_way.join()
    server.start()
    with server.client() as client:
        for batch in batches[middle:]:
            post(client, batch)


def _post_unheard(server: ServerProcess, batch: Batch) -> None:
    try:
        with server.client() as client:
            post(client, batch)
    except httpx.TransportError:
        return


def stored_track(client: httpx.Client, device_id: str) -> list[dict[str, Any]]:
    """Return the track as stored, without the names that differ between devices."""
    points: list[dict[str, Any]] = []
    query: dict[str, Any] = {"limit": 1000}
    while True:
        reply = client.get(f"/v1/devices/{device_id}/track", params=query)
        assert reply.status_code == 200, reply.text
        page = reply.json()
        points += [{k: v for k, v in p.items() if k != "device_id"} for p in page["items"]]
        if page["next_cursor"] is None:
            return points
        query["cursor"] = page["next_cursor"]
