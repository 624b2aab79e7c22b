import numpy as np
import pytest
from api_server import ApiServer
from wifi_hall import SIDE_M, levels_dbm

from app.core.fingerprint.growth import GROWN
from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.core.survey import Surveyed, SurveyPoint, SurveyWalk
from app.core.types import Reading, WifiScan
from app.storage import surveys
from app.storage.floors import StoredFloor, insert_floor
from app.storage.radio_maps import RadioMapOrigin, save_radio_map
from app.storage.sites import StoredSite, insert_site
from app.storage.surveys import Holding, StoredSurvey

pytestmark = pytest.mark.anyio


def walk(y_m: float, floor_id: str = "hall-F1") -> SurveyWalk:
    """Return a walk along the hall with a scan every two metres and waypoints at both ends."""
    rng = np.random.default_rng(int(y_m))
    places = np.arange(0.0, SIDE_M + 1.0, 2.0).tolist()
    scans = tuple(
        WifiScan(x, tuple(Reading((key,), v) for key, v in levels_dbm(x, y_m, rng).items()))
        for x in places
    )
    ends = np.array([(0.0, 0.0, y_m), (SIDE_M, SIDE_M, y_m)])
    return SurveyWalk(f"walk-{y_m:.0f}", floor_id, scans, np.zeros((0, 3)), ends)


async def stored(server: ApiServer, survey_id: str, *records: Surveyed, scans: int = 1) -> str:
    """Store a survey of the hall and return the address of its report."""
    holdings = (Holding("hall-F1", len(records), scans, 0, 12),)
    survey = StoredSurvey(
        survey_id, "hall", f"{survey_id} walks", "ms2020", server.clock.now_s() - 86_400.0, holdings
    )
    rows = [
        surveys.walk_row(r) if isinstance(r, SurveyWalk) else surveys.points_row([r])
        for r in records
    ]

    def fill(connection):
        surveys.begin_survey(connection, survey)
        surveys.add_records(connection, survey_id, rows)
        surveys.complete_survey(connection, survey)

    await server.app.state.context.database.write(fill)
    return f"/v1/surveys/{survey_id}/report"


@pytest.fixture
async def hall(server: ApiServer) -> ApiServer:
    """Return the server with a hall of one floor, without a radio map."""

    def fill(connection):
        insert_site(connection, StoredSite("hall", "Hall", 0.0))
        insert_floor(connection, StoredFloor("hall-F1", "hall", "F1", 0, SIDE_M, SIDE_M))

    await server.app.state.context.database.write(fill)
    return server


async def activate_map(server: ApiServer, *rows_m: float, walks: str = "walk-") -> str:
    """Make walks along these rows, so named, the active radio map; return its id."""
    rng = np.random.default_rng(9)
    surveyed = [
        Fingerprint(0, x, y, levels_dbm(x, y, rng), {}, f"{walks}{y:.0f}")
        for y in rows_m
        for x in np.arange(0.0, SIDE_M + 1.0, 2.0).tolist()
    ]

    def fill(connection):
        radio_map = build_radio_map(("hall-F1",), surveyed)
        origin = RadioMapOrigin("spring", server.clock.now_s())
        return save_radio_map(connection, "hall", radio_map, origin, activate=True).radio_map_id

    return await server.app.state.context.database.write(fill)


async def test_a_survey_of_several_walks_is_judged_by_leaving_each_out(hall: ApiServer):
    url = await stored(hall, "spring", walk(4.0), walk(8.0), walk(12.0))
    async with hall.client("viewer") as client:
        report = (await client.get(url)).raise_for_status().json()
        page = await client.get(url, headers={"Accept": "text/html"})
    assert (report["survey_id"], report["judged_by"]) == ("spring", "other_walks")
    assert report["radio_map_id"] is None
    assert report["age_days"] == 1.0
    (floor,) = report["floors"]
    assert (floor["walks"], floor["scans"]) == (3, 63)
    assert 0.5 < floor["median_error_m"] < 6.0
    assert min(spot["y_m"] for spot in report["thin_spots"]) > 12.0
    assert page.headers["content-type"].startswith("text/html")
    assert "survey spring walks" in page.text
    assert "matched with the other walks of the survey" in page.text
    assert "data:image/png;base64," in page.text


async def test_a_survey_of_one_walk_is_judged_by_the_active_radio_map(hall: ApiServer):
    url = await stored(hall, "one", walk(8.0))
    async with hall.client("viewer") as client:
        alone = (await client.get(url)).raise_for_status().json()
        assert alone["judged_by"] == "nothing"
        assert alone["floors"][0]["median_error_m"] is None
        # The same walk in the active map says nothing of itself, and neither does a map of it.
        await activate_map(hall, 8.0)
        assert (await client.get(url)).json()["judged_by"] == "nothing"
        # What grew from it is no other survey.
        await activate_map(hall, 4.0, 12.0, walks=GROWN)
        assert (await client.get(url)).json()["judged_by"] == "nothing"
        radio_map_id = await activate_map(hall, 4.0, 8.0, 12.0)
        report = (await client.get(url)).raise_for_status().json()
        page = await client.get(url, headers={"Accept": "text/html"})
    assert (report["judged_by"], report["radio_map_id"]) == ("active_radio_map", radio_map_id)
    (floor,) = report["floors"]
    assert (floor["walks"], floor["scans"]) == (1, 21)
    assert set(report["scans"]["y_m"]) == {8.0}
    # Matched with the rows 4 m aside: the walk's own row in the map would be nearer than that.
    assert 2.0 < floor["median_error_m"] < 6.0
    assert "the active radio map" in page.text


async def test_points_are_judged_by_the_other_points(hall: ApiServer):
    points = [
        SurveyPoint(f"P{i}", "hall-F1", x, 4.0, levels_dbm(x, 4.0), {})
        for i, x in enumerate((2.0, 6.0, 10.0))
    ]
    url = await stored(hall, "points", *points)
    async with hall.client("viewer") as client:
        report = (await client.get(url)).raise_for_status().json()
    assert report["judged_by"] == "other_walks"
    assert report["floors"][0]["walks"] == 3


async def test_a_survey_that_makes_no_fingerprint_or_too_many_has_no_report(hall: ApiServer):
    nowhere = await stored(hall, "attic", walk(4.0, floor_id="attic"))
    huge = await stored(hall, "huge", walk(4.0), scans=20_001)
    async with hall.client("viewer") as client:
        refused = await client.get(nowhere)
        assert (refused.status_code, refused.json()["code"]) == (409, "conflict")
        assert "none of it can be placed" in refused.json()["detail"]
        too_many = await client.get(huge)
        assert too_many.status_code == 409
        assert "at most 20000 scans" in too_many.json()["detail"]
        assert (await client.get("/v1/surveys/none/report")).status_code == 404
        assert (await client.get(huge, headers={"Accept": "image/png"})).status_code == 406
    async with hall.client("annex-viewer") as client:
        assert (await client.get(huge)).status_code == 403
