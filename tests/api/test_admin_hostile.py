"""What nobody sends by mistake: sizes, nesting, encodings, numbers that are none, NUL."""

import json

import pytest
from api_server import ApiServer

pytestmark = pytest.mark.anyio

JSON = {"Content-Type": "application/json"}
MERGE = {"Content-Type": "application/merge-patch+json"}


EMPTY_MAP = b'{"type":"FeatureCollection","features":[]}'


def map_with(coordinates: str) -> bytes:
    geometry = f'{{"type":"Polygon","coordinates":[[{coordinates},[1,1],[2,2],{coordinates}]]}}'
    return (
        '{"type":"FeatureCollection","features":[{"type":"Feature",'
        f'"properties":{{"kind":"walkable"}},"geometry":{geometry}}}]}}'
    ).encode()


BODIES = [
    ("POST", "/v1/sites", JSON, b"[" * 100_000, 400),
    ("POST", "/v1/sites", JSON, b'{"name":' * 50_000, 400),
    ("POST", "/v1/sites", JSON, b"\xff", 400),
    ("POST", "/v1/sites", JSON, b"", 422),
    ("POST", "/v1/sites", JSON, b" " * 2_000_000, 413),
    ("POST", "/v1/login", JSON, b" " * 2_000_000, 413),
    ("POST", "/v1/sites", {"Content-Type": "text/plain"}, b'{"name":"x"}', 422),
    ("POST", "/v1/sites", JSON, b'{"name":"x","retention_days":NaN}', 422),
    ("POST", "/v1/sites", JSON, b'{"name":"x","retention_days":1e999}', 422),
    ("POST", "/v1/sites", JSON, b'{"name":"a\\u0000b"}', 422),
    ("POST", "/v1/sites", JSON, b'{"name":"\\ud800"}', 422),
    ("POST", "/v1/sites", JSON, b'{"name":"x","\\ud800":1}', 422),
    ("POST", "/v1/beacons/import?site_id=lab", JSON, b'[{"beacon_id":"\\ud800"}]', 400),
    ("POST", "/v1/beacons/import?site_id=lab", JSON, b'[{"beacon_id":"b","x":NaN}]', 400),
    ("POST", "/v1/beacons/import?site_id=lab", JSON, b"[" * 100_000, 400),
    ("PATCH", "/v1/sites/lab", MERGE, b"[" * 100_000, 400),
    ("PATCH", "/v1/sites/lab", MERGE, b'{"retention_days":NaN}', 400),
    ("PATCH", "/v1/sites/lab", MERGE, b"[]", 400),
    ("PATCH", "/v1/sites/lab", MERGE, b" " * 2_000_000, 413),
    ("PATCH", "/v1/sites/lab", MERGE, b'{"site_id":"other"}', 422),
    ("PUT", "/v1/floors/lab-0/map", JSON, b"[" * 100_000, 400),
    ("PUT", "/v1/floors/lab-0/map", JSON, b"[]", 400),
    ("PUT", "/v1/floors/lab-0/map", JSON, EMPTY_MAP.replace(b"}", b',"x":"\\ud800"}'), 400),
    ("PUT", "/v1/floors/lab-0/map", MERGE | {"Content-Type": "text/plain"}, b"{}", 415),
    ("PUT", "/v1/floors/lab-0/map", JSON, map_with("[NaN,0]"), 400),
    ("PUT", "/v1/floors/lab-0/map", JSON, map_with("[1e308,0]"), 422),
    ("PUT", "/v1/floors/lab-0/map", JSON, map_with('["a",0]'), 422),
    ("PUT", "/v1/floors/lab-0/map", JSON, map_with(f"[1{'0' * 400},0]"), 422),
    ("PUT", "/v1/floors/lab-0/map", JSON, map_with("[[0],0]"), 422),
    ("PUT", "/v1/floors/lab-0/map", JSON, map_with("null"), 422),
]


async def test_hostile_bodies_are_refused_with_a_problem(server: ApiServer) -> None:
    async with server.client() as admin:
        for method, path, headers, body, status in BODIES:
            reply = await admin.request(method, path, content=body, headers=headers)
            assert reply.status_code == status, (method, path, body[:60], reply.text[:200])
            assert reply.headers["Content-Type"] == "application/problem+json"
            assert reply.json()["code"]
        assert (await admin.get("/v1/sites/lab")).headers["ETag"] == '"1"'


async def test_a_large_body_is_refused_before_it_is_known_who_sends_it(server: ApiServer) -> None:
    async with server.client(None) as nobody:
        reply = await nobody.post("/v1/sites", content=b" " * 2_000_000, headers=JSON)
        assert reply.status_code == 413
        for path in ("/v1/floors/lab-0/map", "/v1/floors/lab-0/plan"):
            reply = await nobody.put(path, content=b" " * 40_000_000, headers=JSON)
            assert reply.status_code == 401


async def test_nul_never_reaches_the_database(server: ApiServer) -> None:
    async with server.client() as admin:
        for path in ("/v1/sites/%00", "/v1/devices/a%00/track", "/v1/floors?site_id=%00"):
            assert (await admin.get(path)).status_code == 404
        cursor = {"cursor": "YQBi"}
        assert (await admin.get("/v1/sites", params=cursor)).json()["code"] == "invalid_cursor"
        body = {"kind": "ble", "keys": ["mac:a4c138000001"], "floor_id": "\0", "x": 0.0, "y": 0.0}
        for field in ("site_id", "beacon_id", "name", "floor_id"):
            wrong = {**body, "site_id": "lab", "floor_id": "lab-0", field: "a\0"}
            reply = await admin.post("/v1/beacons", content=json.dumps(wrong), headers=JSON)
            assert reply.status_code == 422, field


async def test_odd_paths_are_not_found(server: ApiServer) -> None:
    async with server.client() as admin:
        for path in ("/v1/sites/%ff", "/v1/devices/a%2Fb", f"/v1/beacons/{'x' * 5000}", "/v1/none"):
            reply = await admin.get(path)
            assert (reply.status_code, reply.json()["code"]) == (404, "not_found")
