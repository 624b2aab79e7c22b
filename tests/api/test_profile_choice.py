"""Sites and devices choose among the profiles that there are."""

import pytest
from api_server import ApiServer, batch, ble_record

from app.core.engine import PROFILES

pytestmark = pytest.mark.anyio

PATCH = {"Content-Type": "application/merge-patch+json"}


async def test_profiles_are_listed_with_what_can_be_set_in_them(server: ApiServer) -> None:
    async with server.client("viewer") as viewer:
        page = (await viewer.get("/v1/profiles")).json()
        best = (await viewer.get("/v1/profiles/best")).json()
    assert page["next_cursor"] is None
    assert [profile["name"] for profile in page["items"]] == sorted(PROFILES)
    assert best in page["items"]
    (lateration,) = (group for group in best["groups"] if group["name"] == "lateration")
    (window,) = (one for one in lateration["parameters"] if one["name"] == "window_s")
    assert (window["value"], window["unit"]) == (2.0, "s")
    assert window["description"].startswith("Length of the window")


@pytest.mark.parametrize(
    ("path", "field"), [("/v1/sites/lab", "default_profile"), ("/v1/devices/phone-7", "profile")]
)
async def test_an_unknown_profile_is_refused_with_the_names(
    server: ApiServer, path: str, field: str
) -> None:
    async with server.client("admin") as admin:
        posted = batch(ble_record(6.0, 4.0, server.clock.now_s() * 1000.0), site="lab")
        assert (await admin.post("/v1/ingest", json=posted)).status_code == 200
        refused = await admin.patch(path, json={field: "bset"}, headers=PATCH)
        taken = await admin.patch(path, json={field: "best"}, headers=PATCH)
    assert refused.status_code == 422
    (error,) = refused.json()["errors"]
    assert error["pointer"] == f"#/{field}"
    assert (
        f"there is no profile 'bset'; there are: {', '.join(sorted(PROFILES))}" in error["detail"]
    )
    assert taken.status_code == 200
    assert taken.json()[field] == "best"


async def test_openapi_names_the_profiles(server: ApiServer) -> None:
    schemas = server.app.openapi()["components"]["schemas"]
    field = schemas["NewSite"]["properties"]["default_profile"]
    assert field["enum"] == sorted(PROFILES)
    patch = server.app.openapi()["paths"]["/v1/devices/{device_id}"]["patch"]["requestBody"]
    (content,) = patch["content"].values()
    assert str(sorted(PROFILES)) in str(content["schema"]["properties"]["profile"])


async def test_a_session_follows_its_device_then_its_site_unless_it_named_a_profile(
    server: ApiServer,
) -> None:
    other = next(name for name in sorted(PROFILES) if name != "best")
    profiles = []
    async with server.client("admin") as admin:

        async def walk_on(**fields: object) -> str:
            seq = len(profiles)
            heard = ble_record(6.0, 4.0, server.clock.now_s() * 1000.0 + seq)
            reply = await admin.post("/v1/ingest", json=batch(heard, seq=seq, site="lab", **fields))
            assert reply.status_code == 200, reply.text
            return reply.json()["fix"]["profile"]

        profiles.append(await walk_on())
        for path, patch in (
            ("/v1/devices/phone-7", {"profile": other}),
            ("/v1/devices/phone-7", {"profile": None}),
            ("/v1/sites/lab", {"default_profile": other}),
            ("/v1/devices/phone-7", {"profile": "best"}),
        ):
            assert (await admin.patch(path, json=patch, headers=PATCH)).status_code == 200
            profiles.append(await walk_on())
        named = [await walk_on(session="named", profile=other)]
        profiles.append(named[0])
        named.append(await walk_on(session="named"))
    assert profiles[:5] == ["best", other, "best", other, "best"]
    assert named == [other, other]
