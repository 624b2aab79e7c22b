"""Every registry route against every role, and against a token of another site."""

import re

import pytest
from api_server import ApiServer, batch, ble_record

pytestmark = pytest.mark.anyio

READ = {"admin": 200, "supervisor": 200, "surveyor": 200, "viewer": 200, "phone-7": 403}
OWN = {**READ, "phone-7": 200, "fleet": 403}
EDIT = {"admin": None, "supervisor": 403, "surveyor": 403, "viewer": 403, "phone-7": 403}

FLOOR = {"name": "One", "ordinal": 1, "width": 9.0, "height": 9.0}
BEACON = {"kind": "ble", "keys": ["mac:a4c138000001"]}
POINTS = [
    {"x": 0.0, "y": 0.0, "lat": 48.0, "lon": 8.0},
    {"x": 20.0, "y": 0.0, "lat": 48.0, "lon": 8.001},
]
MAP = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"kind": "walkable"},
            "geometry": {"type": "Polygon", "coordinates": [[[0, 0], [9, 0], [9, 9], [0, 0]]]},
        }
    ],
}
CSV = "beacon_id,kind,floor_id,x,y,keys\n"

# Method, path at site lab, JSON body, what each role gets (None: whatever is not 401 or 403).
ROUTES = [
    ("GET", "/v1/sites", None, READ),
    ("POST", "/v1/sites", {"name": "New", "site_id": "new"}, EDIT),
    ("GET", "/v1/sites/lab", None, READ),
    ("PUT", "/v1/sites/lab", {"name": "Lab"}, EDIT),
    ("PATCH", "/v1/sites/lab", {"name": "Lab"}, EDIT),
    ("DELETE", "/v1/sites/lab", None, EDIT),
    ("PUT", "/v1/sites/lab/georeference", {"control_points": POINTS}, EDIT),
    ("GET", "/v1/sites/lab/georeference", None, {**READ, "admin": None}),
    ("DELETE", "/v1/sites/lab/georeference", None, EDIT),
    ("GET", "/v1/sites/lab/growth", None, EDIT),
    ("POST", "/v1/sites/lab/growth/accept", None, EDIT),
    ("DELETE", "/v1/sites/lab/growth", None, EDIT),
    ("GET", "/v1/floors", None, READ),
    ("POST", "/v1/floors", {**FLOOR, "site_id": "lab", "floor_id": "lab-1"}, EDIT),
    ("GET", "/v1/floors/lab-0", None, READ),
    ("PUT", "/v1/floors/lab-0", FLOOR, EDIT),
    ("PATCH", "/v1/floors/lab-0", {"name": "Zero"}, EDIT),
    ("DELETE", "/v1/floors/lab-0", None, EDIT),
    ("PUT", "/v1/floors/lab-0/plan", None, EDIT),
    ("GET", "/v1/floors/lab-0/plan", None, {**dict.fromkeys(READ), "phone-7": 403}),
    ("DELETE", "/v1/floors/lab-0/plan", None, EDIT),
    ("PUT", "/v1/floors/lab-0/map", MAP, EDIT),
    ("GET", "/v1/floors/lab-0/map", None, {**READ, "admin": None}),
    ("GET", "/v1/floors/lab-0/map/features", None, READ),
    ("POST", "/v1/floors/lab-0/map/features", {**MAP["features"][0], "id": "room"}, EDIT),
    ("GET", "/v1/floors/lab-0/map/features/room", None, {**READ, "admin": None}),
    ("PATCH", "/v1/floors/lab-0/map/features/room", {"properties": {"name": "Room"}}, EDIT),
    ("DELETE", "/v1/floors/lab-0/map/features/room", None, EDIT),
    ("DELETE", "/v1/floors/lab-0/map", None, EDIT),
    ("GET", "/v1/beacons", None, READ),
    ("POST", "/v1/beacons", {**BEACON, "site_id": "lab", "beacon_id": "new"}, EDIT),
    ("POST", "/v1/beacons/import?site_id=lab", CSV, EDIT),
    ("GET", "/v1/beacons/export?site_id=lab", None, READ),
    ("GET", "/v1/beacons/b1", None, READ),
    ("PUT", "/v1/beacons/b1", BEACON, EDIT),
    ("PATCH", "/v1/beacons/b1", {"name": "door"}, EDIT),
    ("DELETE", "/v1/beacons/b1", None, EDIT),
    ("GET", "/v1/radio-maps", None, READ),
    ("GET", "/v1/radio-maps/none", None, {**dict.fromkeys(READ, 404), "phone-7": 403}),
    ("GET", "/v1/profiles", None, READ),
    ("GET", "/v1/profiles/none", None, {**dict.fromkeys(READ, 404), "phone-7": 403}),
    ("GET", "/v1/tokens", None, {**EDIT, "admin": 200}),
    ("POST", "/v1/tokens", {"name": "x", "role": "viewer", "site_id": "lab"}, EDIT),
    ("GET", "/v1/tokens/{lab-token}", None, {**EDIT, "admin": 200}),
    ("DELETE", "/v1/tokens/{lab-token}", None, EDIT),
    ("GET", "/v1/devices", None, READ),
    ("GET", "/v1/devices/phone-7", None, READ),
    ("PATCH", "/v1/devices/phone-7", {"person": "Ada"}, EDIT),
    ("GET", "/v1/devices/phone-7/fix", None, OWN),
    ("GET", "/v1/devices/phone-7/track", None, OWN),
    ("POST", "/v1/devices/phone-7/replay", {}, READ),
    ("GET", "/v1/fixes?site_id=lab", None, READ),
    ("DELETE", "/v1/devices/phone-7", None, EDIT),
]

_LISTS = {
    path for method, path, *_ in ROUTES if method == "GET" and re.fullmatch(r"/v1/[a-z-]+", path)
}

_OF_NO_SITE = {"/v1/profiles": 200, "/v1/profiles/none": 404, "/v1/radio-maps/none": 404}


async def _token(server: ApiServer, **grant: object) -> dict[str, str]:
    async with server.client() as admin:
        reply = await admin.post("/v1/tokens", json={"name": "t", **grant})
    assert reply.status_code == 201, reply.text
    return reply.json()


async def _prepare(server: ApiServer) -> str:
    """Let phone-7 post a scan and make a token of site lab; return that token's id."""
    now_ms = server.clock.now_s() * 1000.0
    async with server.client("phone-7") as phone:
        reply = await phone.post("/v1/ingest", json=batch(ble_record(6.0, 4.0, now_ms)))
        assert reply.status_code == 200
    return (await _token(server, role="viewer", site_id="lab"))["token_id"]


async def _call(client: object, method: str, path: str, body: object) -> object:
    headers = {"Content-Type": "application/merge-patch+json"} if method == "PATCH" else {}
    if isinstance(body, str):
        return await client.request(
            method, path, content=body, headers={"Content-Type": "text/csv"}
        )
    return await client.request(method, path, json=body, headers=headers)


async def test_each_role_may_do_exactly_what_the_table_says(server: ApiServer) -> None:
    lab_token = await _prepare(server)
    wrong = []
    for method, path, body, expected in ROUTES:
        target = path.replace("{lab-token}", lab_token)
        # Least privilege first: an admin's DELETE comes last.
        for role in sorted(expected, key=lambda name: name == "admin"):
            async with server.client(role) as client:
                status = (await _call(client, method, target, body)).status_code
            wanted = expected[role]
            if status != wanted and (wanted is not None or status in {401, 403, 500}):
                wrong.append(f"{role} {method} {path}: {status}, not {wanted}")
    assert not wrong, "\n".join(wrong)


async def test_a_token_of_another_site_sees_and_edits_nothing(server: ApiServer) -> None:
    lab_token = await _prepare(server)
    secret = (await _token(server, role="admin", site_id="annex"))["token"]
    wrong = []
    async with server.client(None) as client:
        client.headers["Authorization"] = f"Bearer {secret}"
        for method, path, body, _ in ROUTES:
            target = path.replace("{lab-token}", lab_token)
            reply = await _call(client, method, target, body)
            if path in _OF_NO_SITE:
                assert reply.status_code == _OF_NO_SITE[path]
            elif path in _LISTS and method == "GET":
                foreign = [i for i in reply.json()["items"] if i.get("site_id") != "annex"]
                if reply.status_code != 200 or foreign:
                    wrong.append(f"{method} {path}: {reply.status_code} {foreign}")
            elif (reply.status_code, reply.json()["code"]) != (403, "site_forbidden"):
                wrong.append(f"{method} {path}: {reply.status_code}")
        for path in _LISTS - {"/v1/sites", "/v1/tokens", "/v1/profiles"}:
            reply = await client.get(path, params={"site_id": "lab"})
            if reply.status_code != 403:
                wrong.append(f"GET {path}?site_id=lab: {reply.status_code}")
        everywhere = await client.post("/v1/tokens", json={"name": "x", "role": "admin"})
        assert everywhere.status_code == 403
    assert not wrong, "\n".join(wrong)


async def test_no_route_answers_without_a_token(server: ApiServer) -> None:
    async with server.client(None) as client:
        for method, path, body, _ in ROUTES:
            reply = await _call(client, method, path, body)
            assert reply.status_code == 401, f"{method} {path}"
            assert reply.headers["WWW-Authenticate"].startswith("Bearer")


async def test_a_token_is_shown_once_works_and_can_be_revoked(server: ApiServer) -> None:
    made = await _token(server, role="viewer", site_id="lab", expires="2026-12-01T00:00:00Z")
    async with server.client() as admin, server.client(None) as bearer:
        bearer.headers["Authorization"] = f"Bearer {made['token']}"
        assert (await bearer.get("/v1/sites/lab")).status_code == 200
        listed = (await admin.get("/v1/tokens")).text
        assert made["token"] not in listed
        assert made["token_id"] in listed
        assert (await admin.delete(f"/v1/tokens/{made['token_id']}")).status_code == 204
        assert (await bearer.get("/v1/sites/lab")).json()["code"] == "token_invalid"
        again = (await admin.get(f"/v1/tokens/{made['token_id']}")).json()
    assert again["revoked"] is not None
    assert again["expires"] == "2026-12-01T00:00:00.000Z"


async def test_a_token_expires(server: ApiServer) -> None:
    made = await _token(server, role="viewer", expires="2026-11-22T02:30:00Z")
    async with server.client(None) as bearer:
        bearer.headers["Authorization"] = f"Bearer {made['token']}"
        assert (await bearer.get("/v1/sites")).status_code == 200
        server.clock.time_s += 3600
        assert (await bearer.get("/v1/sites")).json()["code"] == "token_expired"


async def test_grants_that_make_no_sense_are_refused(server: ApiServer) -> None:
    grants = [
        {"role": "device"},
        {"role": "device", "device_id": "a", "device_prefix": "b"},
        {"role": "viewer", "device_id": "a"},
        {"role": "king"},
        {"role": "viewer", "expires": "2026-12-01T00:00:00"},
        {"role": "viewer", "expires": "2020-01-01T00:00:00Z"},
        {"role": "viewer", "expires": "9999-12-31T23:59:59-12:00"},
        {"role": "viewer", "site": "lab"},
    ]
    async with server.client() as admin:
        for grant in grants:
            reply = await admin.post("/v1/tokens", json={"name": "t", **grant})
            assert (reply.status_code, reply.json()["code"]) == (422, "invalid_field"), grant
