"""An admin builds a radio map of surveys, compares, activates, takes back, and carries it away."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from api_server import NOW_S, ApiServer, batch, on_both_databases

from app.core.survey import SurveyWalk
from app.core.types import Reading, WifiScan
from app.storage.surveys import (
    StoredSurvey,
    add_records,
    begin_survey,
    complete_survey,
    walk_row,
)

pytestmark = pytest.mark.anyio

MAPS = "/v1/radio-maps"
ACCESS_POINTS = [(x, y) for x in (0.0, 7.0, 14.0, 20.0) for y in (0.0, 10.0)]


def levels(x_m: float, y_m: float, louder_db: float = 0.0) -> dict[str, float]:
    return {
        f"0242ac1100{i:02}": louder_db
        - 40.0
        - 28.0 * math.log10(max(math.hypot(x_m - ax, y_m - ay), 1.0))
        for i, (ax, ay) in enumerate(ACCESS_POINTS)
    }


def surveyed(seed: int, louder_db: float = 0.0) -> list[SurveyWalk]:
    """Return walks along the room, a noisy scan every metre."""
    rng = np.random.default_rng(seed)
    walks = []
    for i, y_m in enumerate((1.0, 3.0, 5.0, 7.0, 9.0)):
        begin_s = 10_000.0 * seed + 100.0 * i
        scans = tuple(
            WifiScan(
                begin_s + x,
                tuple(
                    Reading((f"mac:{mac}",), level + rng.normal(0.0, 3.0))
                    for mac, level in levels(float(x), y_m, louder_db).items()
                ),
            )
            for x in range(21)
        )
        waypoints = np.array([(begin_s, 0.0, y_m), (begin_s + 20.0, 20.0, y_m)])
        walks.append(SurveyWalk(f"w{seed}-{i}", "lab-0", scans, np.empty((0, 3)), waypoints))
    return walks


async def store(server: ApiServer, name: str, walks: list[SurveyWalk], site: str = "lab") -> None:
    def statement(connection: Any) -> None:
        survey = StoredSurvey(name, site, name, "test", 0.0)
        begin_survey(connection, survey)
        add_records(connection, name, [walk_row(walk) for walk in walks])
        complete_survey(connection, survey)

    await server.app.state.context.database.write(statement)


async def build(server: ApiServer, *surveys: str, **options: Any) -> dict[str, Any]:
    """Return the job of a build when it has ended."""
    async with server.client() as admin:
        body = {"site_id": "lab", "surveys": list(surveys), **options}
        begun = await admin.post(MAPS, json=body)
        assert begun.status_code == 202, begun.text
        await server.app.state.context.builds.settle()
        return (await admin.get(begun.headers["Location"])).json()


async def active(server: ApiServer) -> list[str]:
    async with server.client("viewer") as viewer:
        page = (await viewer.get(MAPS, params={"site_id": "lab", "active": True})).json()
    return [one["radio_map_id"] for one in page["items"]]


async def two_maps(server: ApiServer, louder_db: float = 0.0) -> tuple[str, str]:
    await store(server, "spring", surveyed(1))
    await store(server, "autumn", surveyed(2, louder_db))
    one, other = await build(server, "spring"), await build(server, "autumn")
    return one["result"]["radio_map_id"], other["result"]["radio_map_id"]


async def activate(server: ApiServer, radio_map_id: str) -> None:
    async with server.client() as admin:
        reply = await admin.post(f"{MAPS}/{radio_map_id}/activate")
    assert reply.status_code == 200, reply.text
    assert reply.json()["active"]


@on_both_databases
async def test_a_build_is_a_job_whose_map_waits_to_be_activated(server: ApiServer) -> None:
    await store(server, "spring", surveyed(1))
    job = await build(server, name="Spring", virtual=False)
    assert (job["state"], job["kind"], job["problem"]) == ("done", "radio map build", None)
    report = job["result"]["report"]
    assert (report["walks"], report["placed_scans"], report["kept_out"]) == (5, 105, [])
    assert await active(server) == []
    async with server.client("viewer") as viewer:
        stored = (await viewer.get(f"{MAPS}/{job['result']['radio_map_id']}")).json()
    assert (stored["name"], stored["fingerprints"], stored["transmitters"]) == ("Spring", 105, 8)
    assert stored["provenance"]["surveys"] == ["spring"]
    assert stored["provenance"]["options"] == {
        "virtual": False,
        "cleaning": True,
        "placing": "smoothed",
    }


async def test_a_build_that_comes_to_nothing_says_so_and_changes_nothing(
    server: ApiServer,
) -> None:
    one, _ = await two_maps(server)
    await activate(server, one)
    elsewhere = [SurveyWalk(w.walk, "gone", w.scans, w.strides, w.waypoints) for w in surveyed(3)]
    await store(server, "elsewhere", elsewhere)
    job = await build(server, "elsewhere")
    assert (job["state"], job["result"]) == ("failed", None)
    assert "no radio map" in job["problem"]["detail"]
    assert await active(server) == [one]


@on_both_databases
async def test_activating_and_rolling_back(server: ApiServer) -> None:
    one, other = await two_maps(server)
    await activate(server, one)
    await activate(server, other)
    assert await active(server) == [other]
    async with server.client() as admin:
        back = await admin.post("/v1/sites/lab/radio-map/rollback")
        assert (back.status_code, back.json()["radio_map_id"]) == (200, one)
        assert await active(server) == [one]
        again = await admin.post("/v1/sites/lab/radio-map/rollback")
        assert (again.status_code, again.json()["code"]) == (409, "conflict")
        refused = await admin.delete(f"{MAPS}/{one}")
        assert (refused.status_code, refused.json()["code"]) == (409, "in_use")
        assert (await admin.delete(f"{MAPS}/{other}")).status_code == 204
        assert (await admin.get(f"{MAPS}/{other}")).status_code == 404
    assert await active(server) == [one]


async def test_what_changed_between_two_maps(server: ApiServer) -> None:
    one, other = await two_maps(server, louder_db=9.0)
    async with server.client("viewer") as viewer:
        change = (await viewer.get(f"{MAPS}/{one}/compare/{other}")).json()
    assert (change["transmitters_gained"], change["transmitters_lost"]) == ([], [])
    assert len(change["transmitters_changed"]) == len(ACCESS_POINTS)
    assert all(abs(c["change_db"] - 9.0) < 1.5 for c in change["transmitters_changed"])
    assert 0.5 < change["error_before_m"] < 5.0
    assert {(p["floor_id"], p["rows_before"] == p["rows_after"]) for p in change["places"]} == {
        ("lab-0", True)
    }


@on_both_databases
async def test_an_exported_map_is_the_same_where_it_is_imported(server: ApiServer) -> None:
    one, _ = await two_maps(server)
    async with server.client() as admin:
        file = await admin.get(f"{MAPS}/{one}/export")
        assert file.headers["Content-Type"] == "application/zip"
        taken = await admin.post(f"{MAPS}/import", params={"site_id": "lab"}, content=file.content)
        assert taken.status_code == 201, taken.text
        stored = taken.json()
        assert (stored["version"], stored["active"], stored["name"]) == (
            3,
            False,
            "built from surveys",
        )
        again = await admin.get(f"{MAPS}/{stored['radio_map_id']}/export")
        assert again.content == file.content
        elsewhere = await admin.post(
            f"{MAPS}/import", params={"site_id": "annex"}, content=file.content
        )
        assert (elsewhere.status_code, elsewhere.json()["code"]) == (422, "invalid_field")
        broken = await admin.post(
            f"{MAPS}/import", params={"site_id": "lab"}, content=file.content[:-40]
        )
        assert (broken.status_code, broken.json()["code"]) == (400, "malformed_body")


async def test_what_is_of_another_site_or_not_there_is_refused(server: ApiServer) -> None:
    await store(server, "theirs", surveyed(1), "annex")
    async with server.client() as admin:
        for body in ({"site_id": "lab", "surveys": ["theirs"]}, {"site_id": "lab"}):
            assert (await admin.post(MAPS, json=body)).status_code == 422
        assert (await admin.post(MAPS, json={"site_id": "none"})).status_code == 404
    async with server.client("viewer") as viewer:
        assert (await viewer.post(MAPS, json={"site_id": "lab"})).status_code == 403
        assert (await viewer.post("/v1/sites/lab/radio-map/rollback")).status_code == 403


async def walk(server: ApiServer, session: str, switch_to: str | None) -> list[dict[str, Any]]:
    """Return the fixes of a phone that walks along the room; half-way the map is switched."""
    rng = np.random.default_rng(7)
    fixes = []
    async with server.client("phone-7") as phone:
        for second in range(18):
            if second == 9 and switch_to is not None:
                await activate(server, switch_to)
            t_ms = (NOW_S + second) * 1000.0
            aps = [
                {"bssid": mac, "rssi": round(level + rng.normal(0.0, 3.0), 1), "age_ms": 0}
                for mac, level in levels(1.0 + second, 5.0).items()
            ]
            step = {"k": "step", "t_ms": t_ms, "len_m": 1.0, "heading_deg": 90.0}
            wifi = {"k": "wifi", "t_ms": t_ms + 1.0, "aps": aps}
            body = batch(step, wifi, seq=second, session=session)
            reply = await phone.post("/v1/ingest", json=body)
            assert reply.status_code == 200, reply.text
            fixes.append(reply.json()["fix"])
    return fixes


@pytest.mark.parametrize("louder_db", [0.0, 6.0])
async def test_a_live_session_goes_on_with_the_new_map_without_a_jump(
    server: ApiServer, louder_db: float
) -> None:
    one, other = await two_maps(server, louder_db)
    await activate(server, one)
    kept = await walk(server, "kept", None)
    await activate(server, one)
    switched = await walk(server, "switched", other)
    places = [[(fix["x"], fix["y"]) for fix in fixes] for fixes in (kept, switched)]
    assert places[0][:9] == places[1][:9]
    assert places[0][9:] != places[1][9:]
    for before, after in pairwise(switched):
        jump_m = math.dist((before["x"] + 1.0, before["y"]), (after["x"], after["y"]))
        assert jump_m <= before["radius95_m"]
    for fix, second in zip(switched, range(18), strict=True):
        assert math.dist((fix["x"], fix["y"]), (1.0 + second, 5.0)) < 5.0
