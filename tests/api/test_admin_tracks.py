"""Reading fixes and tracks: formats, pages, thinning, times, the globe."""

import csv
import io
import math
from xml.etree import ElementTree as ET

import pytest
from api_server import NOW_S, ApiServer, batch, ble_record

pytestmark = pytest.mark.anyio

TRACK = "/v1/devices/phone-7/track"
POINTS = [
    {"x": 0.0, "y": 0.0, "lat": 48.0, "lon": 8.0},
    {"x": 100.0, "y": 0.0, "lat": 48.0, "lon": 8.001},
    {"x": 0.0, "y": 100.0, "lat": 48.001, "lon": 8.0},
]


async def walk(server: ApiServer, seconds: int = 30) -> list[dict]:
    """Let phone-7 walk along the room, a scan each second; return its whole track."""
    async with server.client("phone-7") as phone:
        for i in range(seconds):
            record = ble_record(2.0 + 16.0 * i / seconds, 5.0, NOW_S * 1000 + 1000.0 * i)
            reply = await phone.post("/v1/ingest", json=batch(record, seq=i))
            assert reply.status_code == 200, reply.text
            server.clock.time_s += 1.0
        return (await phone.get(TRACK)).json()["items"]


async def test_a_track_is_complete_up_to_the_newest_batch(server: ApiServer) -> None:
    items = await walk(server)
    assert items[-1]["time"] == "2026-11-22T02:20:30.000Z"
    times = [item["time"] for item in items]
    assert times == sorted(set(times))
    assert len(items) >= 25
    assert {item["site_id"] for item in items} == {"lab"}
    assert items[-1]["x"] > items[0]["x"] + 8.0
    async with server.client("viewer") as viewer:
        fix = (await viewer.get("/v1/devices/phone-7/fix")).json()["fix"]
        assert fix == items[-1]
        everybody = (await viewer.get("/v1/fixes", params={"floor_id": "lab-0"})).json()
        assert everybody == {"items": [fix], "next_cursor": None}
        nobody = (await viewer.get("/v1/fixes", params={"floor_id": "other"})).json()
    assert nobody["items"] == []


async def test_a_track_is_complete_while_its_session_sleeps(server: ApiServer) -> None:
    items = await walk(server, 8)
    await server.app.state.context.registry.close()
    async with server.client("viewer") as viewer:
        assert (await viewer.get(TRACK)).json()["items"] == items


async def test_pages_join_to_the_whole_also_when_thinned(server: ApiServer) -> None:
    items = await walk(server)
    async with server.client("viewer") as viewer:
        for thin, limit in (({}, 7), ({"every": "5s"}, 2), ({"every": "3s"}, 1)):
            whole = (await viewer.get(TRACK, params=thin)).json()["items"]
            joined, cursor = [], None
            while True:
                params = {**thin, "limit": limit} | ({"cursor": cursor} if cursor else {})
                reply = await viewer.get(TRACK, params=params)
                joined += reply.json()["items"]
                cursor = reply.json()["next_cursor"]
                if cursor is None:
                    break
                assert 'rel="next"' in reply.headers["Link"]
            assert joined == whole
            if not thin:
                assert whole == items
    assert len(whole) == pytest.approx(len(items) / 3, abs=1)


async def test_times_are_half_open(server: ApiServer) -> None:
    items = await walk(server)
    first, end = items[5]["time"], items[9]["time"]
    async with server.client("viewer") as viewer:
        part = (await viewer.get(TRACK, params={"from": first, "to": end})).json()["items"]
        assert part == items[5:9]
        offset = first.replace("Z", "+00:00").replace("T02", "T03").replace("+00", "+01")
        same = (await viewer.get(TRACK, params={"from": offset, "to": end})).json()["items"]
        assert same == part
        wrong = [
            {"from": end, "to": first},
            {"from": "2026-11-22T02:20:05"},
            {"from": "1795314001"},
            {"every": "5"},
            {"every": "0s"},
            {"simplify": "-1"},
            {"simplify": "nan"},
            {"limit": 0},
        ]
        for params in wrong:
            reply = await viewer.get(TRACK, params=params)
            assert (reply.status_code, reply.json()["code"]) == (422, "invalid_field"), params
        for cursor in ("abc", "WzFd", "MSA", "MTAwMDAwMDAwMDAwMDAwMDAwMDAwIGE"):
            reply = await viewer.get(TRACK, params={"cursor": cursor})
            assert (reply.status_code, reply.json()["code"]) == (400, "invalid_cursor"), cursor


async def test_simplified_tracks_keep_their_ends_and_shape(server: ApiServer) -> None:
    items = await walk(server)
    async with server.client("viewer") as viewer:
        few = (await viewer.get(TRACK, params={"simplify": 2.0})).json()["items"]
    assert 2 <= len(few) < len(items) / 2
    assert (few[0], few[-1]) == (items[0], items[-1])
    assert all(item in items for item in few)


async def test_fixes_at_a_past_instant(server: ApiServer) -> None:
    items = await walk(server)
    async with server.client("viewer") as viewer:
        for i in (4, len(items) - 1):
            params = {"at": items[i]["time"].replace(".000Z", ".400Z")}
            assert (await viewer.get("/v1/fixes", params=params)).json()["items"] == [items[i]]
        early = {"at": "2026-11-22T02:00:00Z"}
        assert (await viewer.get("/v1/fixes", params=early)).json()["items"] == []
        late = {"at": "2026-11-22T02:20:40Z", "max_age_s": 5}
        assert (await viewer.get("/v1/fixes", params=late)).json()["items"] == []


async def test_formats_by_accept(server: ApiServer) -> None:
    items = await walk(server, 8)
    async with server.client("viewer") as viewer, server.client() as admin:
        text = await viewer.get(TRACK, headers={"Accept": "text/csv"})
        rows = list(csv.DictReader(io.StringIO(text.text)))
        assert [(row["time"], float(row["x"]), row["lat"]) for row in rows] == [
            (item["time"], item["x"], "") for item in items
        ]
        for media_type in ("application/geo+json", "application/gpx+xml"):
            reply = await viewer.get(TRACK, headers={"Accept": media_type})
            assert (reply.status_code, reply.json()["code"]) == (409, "no_georeference")
        refused = await viewer.get(TRACK, headers={"Accept": "image/png"})
        assert (refused.status_code, refused.json()["code"]) == (406, "not_acceptable")

        put = await admin.put("/v1/sites/lab/georeference", json={"control_points": POINTS})
        assert put.json()["residual_rms_m"] < 1e-6
        geo = await viewer.get(TRACK, headers={"Accept": "application/geo+json, text/csv;q=0.5"})
        assert geo.headers["Content-Type"] == "application/geo+json"
        (line,) = geo.json()["features"]
        assert line["geometry"]["type"] == "LineString"
        assert line["properties"]["times"] == [item["time"] for item in items]
        lon, lat = line["geometry"]["coordinates"][-1]
        assert lon == pytest.approx(8.0 + items[-1]["x"] * 1e-5, abs=1e-7)
        assert lat == pytest.approx(48.0 + items[-1]["y"] * 1e-5, abs=1e-7)
        gpx = ET.fromstring(
            (await viewer.get(TRACK, headers={"Accept": "application/gpx+xml"})).text
        )
        places = gpx.findall(".//{http://www.topografix.com/GPX/1/1}trkpt")
        assert math.isclose(float(places[-1].get("lon")), lon, abs_tol=1e-7)
        fix = (await viewer.get("/v1/devices/phone-7/fix")).json()["fix"]
        assert (fix["lat"], fix["lon"]) == (pytest.approx(lat), pytest.approx(lon))


async def test_a_georeference_needs_points_that_span_something(server: ApiServer) -> None:
    path = "/v1/sites/lab/georeference"
    async with server.client() as admin:
        assert (await admin.get(path)).status_code == 404
        for points in (POINTS[:1], [POINTS[0], POINTS[0]], [{**POINTS[0], "lat": 91.0}, POINTS[1]]):
            reply = await admin.put(path, json={"control_points": points})
            assert reply.status_code == 422, points
        assert (await admin.put(path, json={"control_points": POINTS})).status_code == 200
        assert (await admin.get(path)).json()["control_points"] == POINTS
        assert (await admin.get("/v1/sites/lab")).json()["georeferenced"] is True
        assert (await admin.delete(path)).status_code == 204
        assert (await admin.get(path)).status_code == 404


async def test_a_device_reads_its_own_track_only(server: ApiServer) -> None:
    await walk(server, 3)
    async with server.client("fleet") as other:
        for path in (TRACK, "/v1/devices/phone-7/fix"):
            assert (await other.get(path)).json()["code"] == "device_forbidden"


async def test_no_fix_yet_says_why(server: ApiServer) -> None:
    async with server.client("phone-7") as phone:
        stranger = {
            "k": "ble",
            "t_ms": NOW_S * 1000,
            "beacons": [{"mac": "c20000000001", "rssi": -60}],
        }
        await phone.post("/v1/ingest", json=batch(stranger))
        answer = (await phone.get("/v1/devices/phone-7/fix")).json()
    assert answer["fix"] is None
    assert answer["no_fix"]["reason"]


NORTH = [
    {"x": 0.0, "y": 0.0, "lat": 48.0, "lon": 8.0},
    {"x": 100.0, "y": 0.0, "lat": 48.001, "lon": 8.0},
    {"x": 0.0, "y": 100.0, "lat": 48.0, "lon": 7.999},
]


@pytest.mark.parametrize(("points", "axis"), [(None, "y"), (NORTH, "x")])
async def test_walking_north_goes_where_north_is_on_the_plan(
    server: ApiServer, points: list | None, axis: str
) -> None:
    async with server.client("admin") as admin:
        # Whatever was seen of the site before: its georeference counts at once.
        put = await admin.put("/v1/sites/lab/georeference", json={"control_points": POINTS})
        assert put.status_code == 200
        path = "/v1/sites/lab/georeference"
        if points is None:
            assert (await admin.delete(path)).status_code == 204
        else:
            put = await admin.put(path, json={"control_points": points})
            assert put.status_code == 200
        record = ble_record(5.0, 5.0, NOW_S * 1000.0)
        start = await admin.post("/v1/ingest", json=batch(record, site="lab"))
        steps = [
            {"k": "step", "t_ms": NOW_S * 1000.0 + 600.0 * i, "len_m": 0.7, "heading_deg": 0.0}
            for i in range(1, 6)
        ]
        reply = await admin.post("/v1/ingest", json=batch(*steps, seq=1, site="lab"))
        assert reply.status_code == 200, reply.text
        csv_track = await admin.get(TRACK, headers={"Accept": "text/csv"})
    fix = reply.json()["fix"]
    assert fix[axis] - start.json()["fix"][axis] > 2.0
    assert abs((fix["heading_deg"] + 180.0) % 360.0 - 180.0) < 20.0
    (*_, last) = csv.DictReader(io.StringIO(csv_track.text))
    assert float(last["heading_deg"]) == fix["heading_deg"]
