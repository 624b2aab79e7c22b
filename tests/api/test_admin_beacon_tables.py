"""Import and export of beacons as tables."""

import pytest
from api_server import ApiServer

pytestmark = pytest.mark.anyio

IMPORT = "/v1/beacons/import"
HEADER = "beacon_id,kind,floor_id,x,y,keys,ref_level_dbm\n"
CSV = {"Content-Type": "text/csv"}


async def test_an_export_imports_as_unchanged_in_both_formats(server: ApiServer) -> None:
    async with server.client() as admin:
        for media_type in ("text/csv", "application/json"):
            exported = await admin.get(
                "/v1/beacons/export", params={"site_id": "lab"}, headers={"Accept": media_type}
            )
            assert exported.headers["Content-Type"].startswith(media_type)
            reply = await admin.post(
                IMPORT,
                params={"site_id": "lab"},
                content=exported.content,
                headers={"Content-Type": media_type},
            )
            assert reply.json() == {
                "dry_run": False,
                "created": 0,
                "updated": 0,
                "unchanged": 5,
                "changes": [],
                "refused": [],
            }


async def test_an_import_adds_changes_and_lists_what_it_refuses(server: ApiServer) -> None:
    table = (
        f"{HEADER}"
        "n1,ble,lab-0,1,1,mac:a4c138000001,-60\n"
        "b1,ble,lab-0,0.5,0,mac:a4c138000002,-61\n"
        "n2,ble,lab-9,1,1,mac:a4c138000003,-60\n"
        "n3,ble,lab-0,1,1,mac:a4c138000001,-60\n"
        "n1,ble,lab-0,1,1,mac:a4c138000005,-60\n"
        "n4,ble,lab-0,1,1,mac:a4c138000006,900\n"
        "n5,ble,lab-0,one,1,mac:a4c138000007,-60\n"
    )
    async with server.client() as admin:
        for dry_run in (True, False):
            before = (await admin.get("/v1/sites/lab")).json()["model_version"]
            params = {"site_id": "lab", "dry_run": dry_run}
            reply = await admin.post(IMPORT, params=params, content=table, headers=CSV)
            report = reply.json()
            assert (report["dry_run"], report["created"], report["updated"]) == (dry_run, 1, 1)
            changes = {each["beacon_id"]: each for each in report["changes"]}
            assert sorted(changes) == ["b1", "n1"]
            assert changes["n1"]["added"]
            assert changes["b1"]["change"]["x"] == [0.0, 0.5]
            assert "kind" not in changes["b1"]["change"]
            refused = {row["line"]: row["detail"] for row in report["refused"]}
            assert sorted(refused) == [4, 5, 6, 7, 8]
            assert "lab-9" in refused[4]
            assert "n1" in refused[5]
            assert "twice" in refused[6]
            assert "ref_level_dbm" in refused[7]
            after = (await admin.get("/v1/sites/lab")).json()["model_version"]
            assert (after == before) is dry_run
            status = (await admin.get("/v1/beacons/n1")).status_code
            assert status == (404 if dry_run else 200)
        changed = (await admin.get("/v1/beacons/b1")).json()
    assert (changed["x"], changed["keys"]) == (0.5, ["mac:a4c138000002"])


async def test_what_a_table_has_no_column_for_stays_and_an_empty_cell_resets(
    server: ApiServer,
) -> None:
    calibrated = {"name": "door", "z": 2.5, "ref_level_dbm": -63.0, "path_loss_exponent": 2.6}
    async with server.client() as admin:
        stored = (await admin.patch("/v1/beacons/b1", json=calibrated)).json()
        key = stored["keys"][0]
        places = f"beacon_id,kind,floor_id,x,y,keys\nb1,ble,lab-0,0.5,0,{key}\n"
        emptied = f"{HEADER[:-1]},name\nb1,ble,lab-0,0.5,0,{key},,\n"
        for table, expected in (
            (places, {"x": [0.0, 0.5]}),
            (emptied, {"ref_level_dbm": [-63.0, -59.0], "name": ["door", ""]}),
        ):
            for dry_run in (True, False):
                params = {"site_id": "lab", "dry_run": dry_run}
                reply = await admin.post(IMPORT, params=params, content=table, headers=CSV)
                (change,) = reply.json()["changes"]
                assert change["change"] == expected
            reply = await admin.post(IMPORT, params={"site_id": "lab"}, content=table, headers=CSV)
            assert reply.json()["unchanged"] == 1
        left = (await admin.get("/v1/beacons/b1")).json()
    assert (left["z"], left["path_loss_exponent"]) == (2.5, 2.6)


async def test_a_field_that_an_item_does_not_have_stays_its_place_as_a_whole(
    server: ApiServer,
) -> None:
    async with server.client() as admin:
        before = (await admin.patch("/v1/beacons/b1", json={"shadowing_db": 3.5})).json()
        item = {"beacon_id": "b1", "kind": "ble", "keys": before["keys"], "name": "door"}
        await admin.post(IMPORT, params={"site_id": "lab"}, json=[item])
        named = (await admin.get("/v1/beacons/b1")).json()
        assert named == {**before, "name": "door"}
        taken_down = {**item, "floor_id": None}
        await admin.post(IMPORT, params={"site_id": "lab"}, json=[taken_down])
        unplaced = (await admin.get("/v1/beacons/b1")).json()
    assert unplaced == {**named, "floor_id": None, "x": None, "y": None}


async def test_beacons_may_swap_their_keys_in_one_table(server: ApiServer) -> None:
    async with server.client() as admin:
        items = (await admin.get("/v1/beacons/export", params={"site_id": "lab"})).json()["items"]
        items[0]["keys"], items[1]["keys"] = items[1]["keys"], items[0]["keys"]
        reply = await admin.post(IMPORT, params={"site_id": "lab"}, json={"items": items})
        assert (reply.json()["updated"], reply.json()["refused"]) == (2, [])
        assert (await admin.get("/v1/beacons/b1")).json()["keys"] == items[0]["keys"]


async def test_an_import_cannot_take_a_beacon_of_another_site(server: ApiServer) -> None:
    item = {"beacon_id": "b1", "kind": "ble", "keys": ["mac:a4c138000009"]}
    async with server.client() as admin:
        reply = await admin.post(IMPORT, params={"site_id": "annex"}, json=[item])
        claimed = await admin.post(
            IMPORT, params={"site_id": "annex"}, json=[{**item, "site_id": "lab"}]
        )
        unknown = await admin.post(IMPORT, params={"site_id": "none"}, json=[item])
    assert "another site" in reply.json()["refused"][0]["detail"]
    assert claimed.json()["refused"][0]["beacon_id"] == "b1"
    assert unknown.status_code == 404


async def test_what_is_no_table_is_refused(server: ApiServer) -> None:
    cases = [
        (b"x,y\n1,2\n", "text/csv", 400),
        (b"\xff\xfe", "text/csv", 400),
        (b"{}", "application/json", 400),
        (b"[", "application/json", 400),
        (b"[" * 100_000, "application/json", 400),
        (b"beacon_id", "application/xml", 415),
        (bytes((20 << 20) + 1), "text/csv", 413),
    ]
    async with server.client() as admin:
        for body, media_type, status in cases:
            headers = {"Content-Type": media_type}
            reply = await admin.post(
                IMPORT, params={"site_id": "lab"}, content=body, headers=headers
            )
            assert reply.status_code == status, (media_type, body[:20])


async def test_a_bulk_edit_changes_all_or_none(server: ApiServer) -> None:
    async with server.client() as admin:
        etag = (await admin.get("/v1/beacons/b1")).headers["ETag"]
        items = [
            {"beacon_id": "b1", "etag": etag, "patch": {"name": "door"}},
            {"beacon_id": "b2", "patch": {"x": 19.5, "keys": ["bssid:A4-C1-38-00-00-77"]}},
        ]
        reply = await admin.patch("/v1/beacons", json={"items": items})
        assert reply.status_code == 200, reply.text
        first, second = reply.json()["items"]
        assert (first["name"], second["x"]) == ("door", 19.5)
        assert second["keys"] == ["mac:a4c138000077"]
        assert first["etag"] == (await admin.get("/v1/beacons/b1")).headers["ETag"] != etag
        items[1]["patch"] = {"x": 1.0}
        stale = await admin.patch("/v1/beacons", json={"items": items})
        assert (stale.status_code, stale.json()["code"]) == (412, "etag_mismatch")
        assert (await admin.get("/v1/beacons/b2")).json()["x"] == 19.5
        wrong = [{"beacon_id": "b3", "patch": {"x": None}}]
        assert (await admin.patch("/v1/beacons", json={"items": wrong})).status_code == 422
        wrong = [{"beacon_id": "b4", "patch": {}}, {"beacon_id": "b3", "patch": {"z": "high"}}]
        refused = (await admin.patch("/v1/beacons", json={"items": wrong})).json()
        assert refused["errors"][0]["pointer"] == "#/items/1/patch/z"
        assert "b1" in stale.json()["detail"]
        missing = [{"beacon_id": "none", "patch": {}}]
        assert (await admin.patch("/v1/beacons", json={"items": missing})).status_code == 404


async def test_a_key_that_is_taken_is_named_with_its_beacon(server: ApiServer) -> None:
    async with server.client() as admin:
        taken = (await admin.get("/v1/beacons/b1")).json()["keys"]
        new = {"beacon_id": "n1", "site_id": "lab", "kind": "ble", "keys": taken}
        bulk = [{"beacon_id": "b2", "patch": {"keys": taken}}]
        replies = [
            await admin.post("/v1/beacons", json=new),
            await admin.patch("/v1/beacons/b2", json={"keys": taken}),
            await admin.patch("/v1/beacons", json={"items": bulk}),
        ]
    for reply in replies:
        assert (reply.status_code, reply.json()["code"]) == (409, "conflict")
        assert reply.json()["detail"] == f"{taken[0]} is already a key of beacon 'b1'"
