"""Where everybody was is known again after a crash, before any phone posts again."""

import asyncio
import json
from typing import Any

from posting import by_second, header, numbered, post, stored_track
from server_process import ServerProcess
from websockets.sync.client import connect

from app.core.simulate import walk, warehouse
from app.services.demo import install_warehouse
from app.storage.database import Database

START_S = 1_763_769_600.0


def _snapshot(server: ServerProcess) -> list[dict[str, Any]]:
    url = server.url.replace("http", "ws") + "/v1/stream"
    with connect(url, additional_headers=server.headers, subprotocols=["pharos.v1"]) as socket:
        socket.send(json.dumps({"op": "subscribe", "id": "s", "topic": "fixes"}))
        snapshot: list[dict[str, Any]] = json.loads(socket.recv())["snapshot"]
        return snapshot


def test_last_fixes_survive_a_crash(database_url: str, live_server: ServerProcess) -> None:
    live_server.kill()
    world = warehouse(seed=1)
    database = Database(database_url)
    asyncio.run(install_warehouse(database, world, START_S))
    database.close_now()
    live_server.start()
    walked = walk(world, seed=4, start_s=START_S, duration_s=6.0)
    with live_server.client() as client:
        shared = header("picker", world.site.site_id)
        for batch in numbered(shared, by_second(walked.observations)):
            post(client, batch)
        # Reading the track waits until it is stored.
        last = stored_track(client, "picker")[-2] | {"device_id": "picker"}
    live_server.kill()
    live_server.start()
    with live_server.client() as client:
        fix = client.get("/v1/devices/picker/fix").json()["fix"]
        fixes = client.get("/v1/fixes").json()["items"]
        status = client.get("/v1/devices/picker").json()["status"]
    assert fix == last
    assert fixes == [last]
    assert _snapshot(live_server) == [last]
    # A slow machine may take longer to restart than a device counts as live.
    assert status in {"live", "stale"}
