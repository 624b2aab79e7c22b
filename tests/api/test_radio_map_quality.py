import math

import numpy as np
import pytest
from api_server import ApiServer, batch, on_both_databases
from wifi_hall import SIDE_M, levels_dbm

from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.storage.floors import StoredFloor, insert_floor
from app.storage.radio_maps import RadioMapOrigin, save_radio_map
from app.storage.sites import StoredSite, insert_site

pytestmark = pytest.mark.anyio
VANISHED = "mac:000000000000"


async def stored_hall(server: ApiServer) -> str:
    """Store a hall with an active radio map and return the map's id."""
    rng = np.random.default_rng(1)
    grid = np.arange(0.0, SIDE_M + 1.0, 5.0).tolist()
    surveyed = [
        Fingerprint(0, x, y, levels_dbm(x, y, rng), {}, f"row-{y:.0f}-{turn}")
        for turn in range(2)
        for y in grid
        for x in grid
    ]
    context = server.app.state.context

    def fill(connection):
        insert_site(connection, StoredSite("hall", "Hall", 0.0))
        insert_floor(connection, StoredFloor("hall-F1", "hall", "F1", 0, SIDE_M, SIDE_M))
        origin = RadioMapOrigin("survey", server.clock.now_s() - 86_400.0)
        radio_map = build_radio_map(("hall-F1",), surveyed)
        return save_radio_map(connection, "hall", radio_map, origin, activate=True)

    stored = await context.database.write(fill)
    await context.directory.refresh()
    return stored.radio_map_id


async def post_traffic(server: ApiServer) -> None:
    """Post scans of a hall in which one access point is silent."""
    rng = np.random.default_rng(2)
    records = [
        {
            "k": "wifi",
            "t_ms": (server.clock.now_s() - 300.0 + i) * 1000.0,
            "aps": [
                {"bssid": ":".join(key[4:][j : j + 2] for j in range(0, 12, 2)), "rssi": level}
                for key, level in levels_dbm(x, y, rng).items()
                if key != VANISHED
            ],
        }
        for i, (x, y) in enumerate(rng.uniform(0.0, SIDE_M, (250, 2)).tolist())
    ]
    async with server.client("admin") as client:
        body = batch(*records, site="hall")
        reply = await client.post("/v1/ingest", json=body)
        assert reply.status_code < 300, reply.text


async def test_a_report_is_json_or_a_page_to_print(server: ApiServer):
    radio_map_id = await stored_hall(server)
    url = f"/v1/radio-maps/{radio_map_id}/report"
    async with server.client("viewer") as client:
        report = (await client.get(url)).raise_for_status().json()
        page = await client.get(url, headers={"Accept": "text/html"})
    assert report["age_days"] == 1.0
    assert [floor["floor_id"] for floor in report["floors"]] == ["hall-F1"]
    cells = report["cells"]
    assert (
        len(cells["x_m"]) == len(cells["predicted_error_m"]) == math.ceil(SIDE_M / 3.0 - 0.5) ** 2
    )
    assert all(error_m > 0.0 for error_m in cells["predicted_error_m"])
    assert page.headers["content-type"].startswith("text/html")
    assert "data:image/png;base64," in page.text
    assert "Thin spots" in page.text


async def test_a_report_of_another_site_is_refused(server: ApiServer):
    radio_map_id = await stored_hall(server)
    async with server.client("annex-viewer") as client:
        for path in ("report", "ageing"):
            reply = await client.get(f"/v1/radio-maps/{radio_map_id}/{path}")
            assert reply.status_code == 403
    async with server.client() as client:
        assert (await client.get("/v1/radio-maps/none/report")).status_code == 404


@on_both_databases
async def test_what_traffic_contradicts_is_listed_quarantined_and_released(server: ApiServer):
    radio_map_id = await stored_hall(server)
    await post_traffic(server)
    url = f"/v1/radio-maps/{radio_map_id}/ageing"
    directory = server.app.state.context.directory
    async with server.client("surveyor") as client:
        assert (await client.get(url)).json() == {"transmitters": []}
        (aged,) = (await client.post(url)).raise_for_status().json()["transmitters"]
        assert (aged["key"], aged["change"], aged["quarantined"]) == (VANISHED, "vanished", False)
        assert aged["scans"] == aged["misplaced"] == 0 < aged["expected"]
        assert aged["excess"] > 0.0
        assert VANISHED in directory.current("hall").radio_map.column_by_key
        held = (await client.patch(url, json={"quarantine": [VANISHED]})).json()["transmitters"]
        assert [a["quarantined"] for a in held] == [True]
        assert VANISHED not in directory.current("hall").radio_map.column_by_key
        again = (await client.post(url)).json()["transmitters"]
        assert [a["quarantined"] for a in again] == [True]
        await client.patch(url, json={"release": [VANISHED]})
        assert VANISHED in directory.current("hall").radio_map.column_by_key


async def test_only_listed_transmitters_are_quarantined_by_those_who_may(server: ApiServer):
    radio_map_id = await stored_hall(server)
    url = f"/v1/radio-maps/{radio_map_id}/ageing"
    async with server.client("surveyor") as client:
        reply = await client.patch(url, json={"quarantine": [VANISHED]})
        assert reply.status_code == 422
    async with server.client("viewer") as client:
        assert (await client.post(url)).status_code == 403
        assert (await client.patch(url, json={})).status_code == 403


async def test_a_change_of_quarantine_is_made_whole_or_not_at_all(server: ApiServer):
    radio_map_id = await stored_hall(server)
    await post_traffic(server)
    url = f"/v1/radio-maps/{radio_map_id}/ageing"
    directory = server.app.state.context.directory
    async with server.client("surveyor") as client:
        await client.post(url)
        for body in (
            {"quarantine": [VANISHED], "release": ["mac:ffffffffffff"]},
            {"quarantine": [VANISHED], "release": [VANISHED]},
        ):
            reply = await client.patch(url, json=body)
            assert reply.status_code == 422, reply.text
            (aged,) = (await client.get(url)).json()["transmitters"]
            assert not aged["quarantined"]
        await directory.refresh()
    assert VANISHED in directory.current("hall").radio_map.column_by_key
