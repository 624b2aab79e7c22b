"""Walls and walkable areas edited one by one; a plan picture that moves nothing."""

import io
from typing import Any

import httpx
import numpy as np
import pytest
from api_server import NOW_S, ApiServer, batch, ble_record
from PIL import Image
from sqlalchemy import Connection

from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.site import Floor
from app.storage.radio_maps import RadioMapOrigin, load_active, save_radio_map

pytestmark = pytest.mark.anyio

PATH = "/v1/floors/lab-0/map/features"
PLAN = "/v1/floors/lab-0/predicted-accuracy"
MERGE = {"Content-Type": "application/merge-patch+json"}


def wall(x_m: float, **properties: object) -> dict[str, Any]:
    line = {"type": "LineString", "coordinates": [[x_m, 0], [x_m, 10]]}
    return {"type": "Feature", "properties": {"kind": "wall", **properties}, "geometry": line}


def area(kind: str, *corners: tuple[float, float], **members: object) -> dict[str, Any]:
    ring = [list(corner) for corner in (*corners, corners[0])]
    geometry = {"type": "Polygon", "coordinates": [ring]}
    return {"type": "Feature", "properties": {"kind": kind}, "geometry": geometry, **members}


ROOM = area("walkable", (0, 0), (20, 0), (20, 10), (0, 10), id="room")
SHOP = area("obstacle", (0, 0), (8, 0), (8, 4), (0, 4), id="shop")


def ground(server: ApiServer) -> Floor:
    """Return the floor as live sessions fold with it now."""
    floor: Floor = server.app.state.context.directory.current("lab").floors[0]
    return floor


async def added(client: httpx.AsyncClient, feature: dict[str, Any]) -> httpx.Response:
    reply = await client.post(PATH, json=feature)
    assert reply.status_code == 201, reply.text
    return reply


async def test_features_are_added_read_changed_and_removed(server: ApiServer) -> None:
    async with server.client() as admin:
        assert (await admin.get(PATH)).json() == {"items": [], "next_cursor": None}
        await added(admin, ROOM)
        made = await added(admin, wall(12, material="glass"))
        own = made.headers["Location"]
        assert own == f"{PATH}/{made.json()['id']}"
        got = await admin.get(own)
        assert (got.json(), got.headers["ETag"]) == (made.json(), made.headers["ETag"])
        held = await admin.get(own, headers={"If-None-Match": got.headers["ETag"]})
        assert held.status_code == 304
        patch = {"properties": {"material": "brick"}}
        changed = await admin.patch(own, json=patch, headers=MERGE)
        assert changed.json()["properties"] == {"kind": "wall", "material": "brick"}
        assert changed.json()["geometry"] == made.json()["geometry"]
        walls = (await admin.get(PATH, params={"kind": "wall"})).json()["items"]
        assert walls == [changed.json()]
        whole = (await admin.get("/v1/floors/lab-0/map")).json()
        assert whole == {"type": "FeatureCollection", "features": [ROOM, changed.json()]}
        assert (await admin.delete(own)).status_code == 204
        assert (await admin.get(own)).status_code == 404
        assert (await admin.get(PATH)).json()["items"] == [ROOM]


async def test_live_sessions_go_on_with_each_edit(server: ApiServer) -> None:
    async with server.client() as admin:
        await added(admin, ROOM)
        assert ground(server).walkable.distance_at(2, 2) == 0
        await added(admin, SHOP)
        assert ground(server).walkable.distance_at(2, 2) == pytest.approx(2, abs=0.5)
        assert ground(server).walls == ()
        made = await added(admin, wall(12, material="glass"))
        own = made.headers["Location"]
        assert [(w.x0_m, w.attenuation_db) for w in ground(server).walls] == [(12, 2)]
        line = {"type": "LineString", "coordinates": [[5, 0], [5, 10]]}
        patch = {"geometry": line, "properties": {"attenuation_db": 9}}
        await admin.patch(own, json=patch, headers=MERGE)
        assert [(w.x0_m, w.attenuation_db) for w in ground(server).walls] == [(5, 9)]
        await admin.delete(own)
        await admin.delete(f"{PATH}/shop")
        assert ground(server).walls == ()
        assert ground(server).walkable.distance_at(2, 2) == 0
        await admin.delete(f"{PATH}/room")
        assert ground(server).walkable is None


async def test_a_new_wall_counts_in_a_running_session(server: ApiServer) -> None:
    """Two phones hear the same; what one hears last, it hears among other walls."""
    async with server.client() as admin:

        async def place_after(seq: int, device_id: str) -> tuple[float, float]:
            starts_s = NOW_S + seq * 10
            records = [ble_record(4.0, 5.0, (starts_s + i) * 1000.0) for i in range(8)]
            server.clock.time_s = starts_s + 8
            body = batch(*records, seq=seq, device={"id": device_id}, site="lab")
            fix = (await admin.post("/v1/ingest", json=body)).json()["fix"]
            return fix["x"], fix["y"]

        assert await place_after(0, "phone-7") == await place_after(0, "phone-8")
        without = await place_after(1, "phone-8")
        await added(admin, wall(7, material="brick"))
        among = await place_after(1, "phone-7")
    assert np.hypot(*np.subtract(among, without)) > 0.2


async def test_edited_walls_change_what_the_planner_predicts(server: ApiServer) -> None:
    async def in_range(admin: httpx.AsyncClient) -> float:
        body = {"cell_m": 1, "ref_level_dbm": -75}
        reply = await admin.post(PLAN, json=body)
        assert reply.status_code == 200, reply.text
        mean: float = np.mean(reply.json()["in_range"]["grid"])
        return mean

    async with server.client() as admin:
        bare = await in_range(admin)
        made = await added(admin, wall(10.5, material="wood"))
        wooden = await in_range(admin)
        patch = {"properties": {"material": "metal"}}
        await admin.patch(made.headers["Location"], json=patch, headers=MERGE)
        metal = await in_range(admin)
        await admin.delete(made.headers["Location"])
        assert await in_range(admin) == bare
    assert bare > wooden > metal


async def test_a_wrong_feature_is_refused_with_its_place(server: ApiServer) -> None:
    bow_tie = area("walkable", (0, 0), (20, 10), (20, 0), (0, 10))
    cases = [
        (bow_tie, "#/geometry/coordinates", "Self-intersection[10 5]"),
        (wall(25), "#/geometry/coordinates", "[25, 0] is outside of the floor"),
        (area("obstacle", (1, 1), (2, 1), (2, -40)), "#/geometry/coordinates", "[2, -40] is"),
        (wall(3, material="cheese"), "#/properties/material", "glass"),
        (wall(3, attenuation_db=-1), "#/properties/attenuation_db", "0 to 100 dB"),
        ({**wall(3), "properties": {"kind": "door"}}, "#/properties/kind", "walkable"),
        ({**wall(3), "geometry": SHOP["geometry"]}, "#/geometry/type", "LineString"),
        ({**wall(3), "id": "a/b"}, "#/id", "letters"),
        ({**wall(3), "id": 7}, "#/id", "letters"),
        (area("obstacle", (0, 0), (20, 0), (20, 10), (0, 10)), "#", "no place to walk"),
    ]
    async with server.client() as admin:
        await added(admin, ROOM)
        before = (await admin.get("/v1/floors/lab-0")).headers["ETag"]
        for feature, pointer, words in cases:
            reply = await admin.post(PATH, json=feature)
            assert (reply.status_code, reply.json()["code"]) == (422, "invalid_field"), pointer
            (error,) = reply.json()["errors"]
            assert (error["pointer"], words in error["detail"]) == (pointer, True), error
        for patch in ({"id": "hall"}, {"properties": {"kind": "wall"}}, {"geometry": None}):
            reply = await admin.patch(f"{PATH}/room", json=patch, headers=MERGE)
            assert reply.status_code == 422, patch
        assert (await admin.post(PATH, json=ROOM)).status_code == 409
        assert (await admin.get("/v1/floors/lab-0")).headers["ETag"] == before
        assert (await admin.get(PATH)).json()["items"] == [ROOM]


async def test_only_edits_of_the_same_feature_collide(server: ApiServer) -> None:
    async with server.client() as admin:
        await added(admin, ROOM)
        own = (await added(admin, wall(5))).headers["Location"]
        other = (await added(admin, wall(9))).headers["Location"]
        seen = {**MERGE, "If-Match": (await admin.get(own)).headers["ETag"]}
        brick, wood = ({"properties": {"material": m}} for m in ("brick", "wood"))
        assert (await admin.patch(other, json=brick, headers=MERGE)).status_code == 200
        assert (await admin.patch(own, json=brick, headers=seen)).status_code == 200
        assert (await admin.patch(own, json=wood, headers=seen)).status_code == 412
        assert (await admin.delete(own, headers=seen)).status_code == 412
        seen["If-Match"] = (await admin.get(own)).headers["ETag"]
        assert (await admin.delete(own, headers=seen)).status_code == 204


async def test_features_of_a_whole_map_get_ids_that_last(server: ApiServer) -> None:
    """Equal ones too; a number or a text that stands in a URL is kept."""
    named = [{**wall(4), "id": 7}, {**wall(5), "id": "7"}, {**wall(6), "id": "no / id"}]
    document = {"type": "FeatureCollection", "features": [*named, wall(9), wall(9)], "name": "L"}
    async with server.client() as admin:
        assert (await admin.put("/v1/floors/lab-0/map", json=document)).status_code == 204
        assert (await admin.get("/v1/floors/lab-0/map")).json() == document
        items = (await admin.get(PATH)).json()["items"]
        ids = {f["geometry"]["coordinates"][0][0]: f["id"] for f in items}
        assert len({f["id"] for f in items}) == 5
        assert ids[4] == "7"
        pages = []
        page = {"next_cursor": ""}
        while page["next_cursor"] is not None:
            query = {"limit": 2} | ({"cursor": page["next_cursor"]} if pages else {})
            page = (await admin.get(PATH, params=query)).json()
            pages.append(page["items"])
        assert [f for page in pages for f in page] == items
        twins = [f["id"] for f in items if f["geometry"]["coordinates"][0][0] == 9]
        assert (await admin.delete(f"{PATH}/{min(twins)}")).status_code == 204
        left = (await admin.get(PATH)).json()["items"]
        assert left == [f for f in items if f["id"] != min(twins)]
        assert (await admin.get("/v1/floors/lab-0/map")).json()["name"] == "L"


def picture(width: int, height: int) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (width, height)).save(out, "PNG")
    return out.getvalue()


async def test_another_plan_picture_moves_no_coordinate(server: ApiServer) -> None:
    database = server.app.state.context.database
    heard = ({"mac:020000000001": -50.0}, {"mac:020000000001": -70.0})
    fingerprints = [
        Fingerprint(0, 3.0, 4.0, heard[0], {}),
        Fingerprint(0, 12.5, 8.25, heard[1], {}),
    ]

    def survey(connection: Connection) -> None:
        surveyed = build_radio_map(["lab-0"], fingerprints)
        origin = RadioMapOrigin("Spring", NOW_S)
        save_radio_map(connection, "lab", surveyed, origin, activate=True)

    async def everything(admin: httpx.AsyncClient) -> list[Any]:
        floor = (await admin.get("/v1/floors/lab-0")).json()
        beacons = (await admin.get("/v1/beacons", params={"site_id": "lab"})).json()
        stored = await database.read(lambda c: load_active(c, "lab"))
        features = (await admin.get(PATH)).json()
        return [floor, beacons, features, stored.x_m.tolist(), stored.y_m.tolist()]

    await database.write(survey)
    headers = {"Content-Type": "image/png"}
    async with server.client() as admin:
        for feature in (ROOM, SHOP, wall(12)):
            await added(admin, feature)
        await admin.put("/v1/floors/lab-0/plan", content=picture(200, 100), headers=headers)
        before = await everything(admin)
        walls = ground(server).walls
        await admin.put("/v1/floors/lab-0/plan", content=picture(917, 431), headers=headers)
        assert await everything(admin) == before
        assert ground(server).walls == walls
        assert before[3:] == [[3.0, 12.5], [4.0, 8.25]]
