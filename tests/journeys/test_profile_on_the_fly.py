"""Profiles are switched under a walking phone: by its site, by itself, and across a crash."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from posting import Batch, by_second, header, numbered, post, stored_track
from server_process import ServerProcess

from app.core.simulate import walk, warehouse
from app.services.demo import install_warehouse
from app.storage.database import Database

START_S = 1_763_769_600.0
TIMID = "timid"
# A profile that nobody publishes: as the usual one, with wider errors and a slower filter.
REGISTER_TIMID = f"""
from dataclasses import replace
from app.core.engine import PROFILES
best = PROFILES["best"]
fusion = replace(best.params.fusion, lateration_inflation=60.0, noise_m2=60.0)
params = replace(best.params, profile="{TIMID}", fusion=fusion)
PROFILES["{TIMID}"] = replace(best, params=params)
"""


@pytest.fixture
def server(database_url: str, tmp_path: Path) -> Iterator[ServerProcess]:
    database = Database(database_url)
    asyncio.run(install_warehouse(database, warehouse(seed=1), START_S))
    database.close_now()
    running = ServerProcess(database_url, tmp_path / "server.log")
    running.prelude = REGISTER_TIMID
    running.start()
    yield running
    running.kill()


def bodies_of(device_id: str, **fields: str) -> list[Batch]:
    world = warehouse(seed=1)
    walked = walk(world, seed=4, start_s=START_S, duration_s=24.0)
    shared = {**header(device_id, world.site.site_id), **fields}
    return numbered(shared, by_second(walked.observations))


def post_all(server: ServerProcess, batches: list[Batch]) -> dict[str, Any]:
    with server.client() as client:
        return [post(client, batch) for batch in batches][-1]["fix"]


def patch(server: ServerProcess, path: str, **fields: str | None) -> None:
    merge_patch = {"Content-Type": "application/merge-patch+json"}
    with server.client() as client:
        reply = client.patch(path, json=fields, headers=merge_patch)
        assert reply.status_code == 200, reply.text


def track_of(server: ServerProcess, device_id: str) -> list[dict[str, Any]]:
    with server.client() as client:
        return stored_track(client, device_id)


def test_a_phone_follows_its_site_then_itself_across_a_crash(server: ServerProcess) -> None:
    site = f"/v1/sites/{warehouse(seed=1).site.site_id}"
    batches = bodies_of("picker")
    assert post_all(server, batches[:8])["profile"] == "best"
    patch(server, site, default_profile=TIMID)
    fix = post_all(server, batches[8:9])
    assert fix["profile"] == TIMID
    with server.client() as client:
        assert client.get("/v1/devices/picker/fix").json()["fix"] == fix
    server.kill()
    server.start()
    assert post_all(server, batches[9:16])["profile"] == TIMID
    patch(server, "/v1/devices/picker", profile="best")
    assert post_all(server, batches[16:])["profile"] == "best"

    # Two phones that walk alike and name their profile do not care for the site's.
    for profile in ("best", TIMID):
        assert post_all(server, bodies_of(profile, profile=profile))["profile"] == profile
    switched = track_of(server, "picker")
    always = {profile: track_of(server, profile) for profile in ("best", TIMID)}
    assert len(switched) > 20
    profiles = [point["profile"] for point in switched]
    first, second = profiles.index(TIMID), profiles.index("best", profiles.index(TIMID))
    assert second - first == 8
    best, timid = always["best"], always[TIMID]
    assert switched == best[:first] + timid[first:second] + best[second:]
    assert best[12]["radius95_m"] < timid[12]["radius95_m"]
