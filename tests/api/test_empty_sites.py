"""Whatever is missing of a site: it is told as an answer or a refusal, never as a failure."""

import asyncio

import pytest
from api_server import ApiServer

from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.survey import SurveyPoint
from app.storage import surveys
from app.storage.floors import StoredFloor, insert_floor
from app.storage.radio_maps import RadioMapOrigin, save_radio_map
from app.storage.sites import StoredSite, insert_site
from app.storage.surveys import Holding, StoredSurvey

pytestmark = pytest.mark.anyio

KEY = "mac:02005e005301"
SQUARE = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"kind": "obstacle"},
            "geometry": {
                "type": "Polygon",
                "coordinates": [[[0, 0], [20, 0], [20, 10], [0, 10], [0, 0]]],
            },
        }
    ],
}


@pytest.fixture
async def lone(server: ApiServer) -> ApiServer:
    """Return the server with a site whose survey and radio map have one fingerprint.

    Beside it stands a site without floors that has a survey, and one whose floor is all obstacle.
    """

    def fill(connection):
        for site_id in ("lone", "bare", "solid"):
            insert_site(connection, StoredSite(site_id, site_id, 0.0))
        insert_floor(connection, StoredFloor("lone-0", "lone", "Ground", 0, 20.0, 10.0))
        insert_floor(connection, StoredFloor("solid-0", "solid", "Ground", 0, 20.0, 10.0))
        point = SurveyPoint("P", "lone-0", 1.0, 2.0, {KEY: -50.0}, {})
        for site_id in ("lone", "bare"):
            holdings = (Holding("lone-0", 0, 0, 1, 1),)
            survey = StoredSurvey(f"{site_id}-survey", site_id, "s", "csv", 1.0, holdings)
            surveys.begin_survey(connection, survey)
            surveys.add_records(connection, survey.survey_id, [surveys.points_row([point])])
            surveys.complete_survey(connection, survey)
        one = build_radio_map(["lone-0"], [Fingerprint(0, 1.0, 2.0, {KEY: -50.0}, {}, "w")])
        for _ in range(2):
            save_radio_map(connection, "lone", one, RadioMapOrigin("m", 1.0), activate=True)

    await server.app.state.context.database.write(fill)
    await server.app.state.context.directory.refresh()
    return server


async def maps(server: ApiServer) -> list[str]:
    async with server.client() as client:
        items = (await client.get("/v1/radio-maps?site_id=lone")).json()["items"]
    return [one["radio_map_id"] for one in items]


@pytest.mark.parametrize("accept", ["application/json", "text/html"])
async def test_a_map_of_one_fingerprint_is_reported(lone: ApiServer, accept: str) -> None:
    (first, _) = await maps(lone)
    async with lone.client() as client:
        for of in (f"radio-maps/{first}", "surveys/lone-survey"):
            reply = await client.get(f"/v1/{of}/report", headers={"Accept": accept})
            assert reply.status_code == 200, reply.text


async def test_a_survey_of_a_site_without_floors_is_refused(lone: ApiServer) -> None:
    async with lone.client() as client:
        reply = await client.get("/v1/surveys/bare-survey/report")
        assert (reply.status_code, reply.json()["code"]) == (409, "conflict")


async def test_two_maps_of_one_fingerprint_are_compared(lone: ApiServer) -> None:
    first, second = await maps(lone)
    async with lone.client() as client:
        reply = await client.get(f"/v1/radio-maps/{first}/compare/{second}")
        assert reply.status_code == 200, reply.text


async def test_a_map_of_one_fingerprint_ages_is_carried_and_locates(lone: ApiServer) -> None:
    (first, _) = await maps(lone)
    record = {"k": "wifi", "t_ms": 1_795_314_000_000, "aps": [{"bssid": KEY[4:], "rssi": -50}]}
    async with lone.client() as client:
        for method, path in (("POST", "ageing"), ("GET", "ageing"), ("GET", "export")):
            reply = await client.request(method, f"/v1/radio-maps/{first}/{path}")
            assert reply.status_code == 200, (path, reply.text)
        imported = await client.post("/v1/radio-maps/import?site_id=lone", content=reply.content)
        assert imported.status_code == 201, imported.text
        located = await client.post("/v1/locate", json={"site": "lone", "records": [record]})
        assert located.status_code == 200, located.text


@pytest.mark.parametrize("site_id", ["annex", "bare", "solid", "lone"])
async def test_jobs_of_a_poor_site_end(lone: ApiServer, site_id: str) -> None:
    async with lone.client() as client:
        build = await client.post("/v1/radio-maps", json={"site_id": site_id})
        growth = await client.post(f"/v1/sites/{site_id}/growth")
        for reply in (build, growth):
            assert reply.status_code < 500, reply.text
            if reply.status_code == 202:
                problem = await ended(client, reply.json()["job_id"])
                assert problem is None or problem["code"] != "internal", problem


async def ended(client, job_id: str) -> dict | None:
    while True:
        job = (await client.get(f"/v1/jobs/{job_id}")).json()
        if job["state"] in {"done", "failed"}:
            return job["problem"]
        await asyncio.sleep(0.02)


@pytest.mark.parametrize("floor_id", ["solid-0", "lone-0"])
async def test_a_floor_without_walkable_area_is_planned_and_calibrated_in_words(
    lone: ApiServer, floor_id: str
) -> None:
    async with lone.client() as client:
        put = await client.put(f"/v1/floors/{floor_id}/map", json=SQUARE)
        assert put.is_success, put.text
        beacons = [{"x": 1, "y": 1}, {"x": 19, "y": 1}, {"x": 10, "y": 9}]
        asked = {"beacons": beacons, "cell_m": 1, "drop_one": True, "add": 1, "cover_m": 2}
        for body in (asked, {"cell_m": 1}, {"beacons": []}):
            for accept in ("application/json", "image/png"):
                reply = await client.post(
                    f"/v1/floors/{floor_id}/predicted-accuracy",
                    json=body,
                    headers={"Accept": accept},
                )
                assert reply.status_code < 500, reply.text
        for path in ("calibration", "beacon-places"):
            for source in (
                {"survey_id": "lone-survey"},
                {"levels": [{"x": 1, "y": 1, "rssi_dbm": -50, "key": KEY}]},
            ):
                reply = await client.post(f"/v1/floors/{floor_id}/{path}", json=source)
                assert reply.status_code < 500, reply.text
        reports = [f"radio-maps/{one}" for one in await maps(lone)] + ["surveys/lone-survey"]
        for of in reports:
            for accept in ("application/json", "text/html"):
                reply = await client.get(f"/v1/{of}/report", headers={"Accept": accept})
                assert reply.status_code < 500, reply.text


@pytest.mark.parametrize("site_id", ["annex", "bare", "solid", "lone"])
async def test_every_list_and_question_of_a_poor_site_is_answered(
    lone: ApiServer, site_id: str
) -> None:
    record = {"k": "wifi", "t_ms": 1_795_314_000_000, "aps": [{"bssid": KEY[4:], "rssi": -50}]}
    gets = ["floors", "beacons", "radio-maps", "surveys", "jobs", "devices", "fixes"]
    paths = [f"{name}?site_id={site_id}" for name in gets]
    paths += [f"beacons/export?site_id={site_id}", f"sites/{site_id}/growth"]
    async with lone.client() as client:
        for path in paths:
            reply = await client.get(f"/v1/{path}")
            assert reply.status_code == 200, (path, reply.text)
        posts = {
            f"/v1/sites/{site_id}/radio-map/rollback": None,
            f"/v1/sites/{site_id}/growth/accept": None,
            "/v1/locate": {"site": site_id, "records": [record]},
        }
        for path, body in posts.items():
            reply = await client.post(path, json=body)
            assert reply.status_code < 500, (path, reply.text)
