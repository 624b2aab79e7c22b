"""Profiles are switched under a walking phone: by its site, by itself, and across a crash."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from posting import Batch, by_second, header, numbered, post, stored_track
from server_process import ServerProcess

from app.core.simulate import walk, warehouse
from app.core.types import Observation
from app.services.demo import install_warehouse
from app.storage.database import Database

START_S = 1_763_769_600.0
# A system of another kind: its state is not that of the usual one.
OTHER = "grinyak2018"


@pytest.fixture
def server(database_url: str, tmp_path: Path) -> Iterator[ServerProcess]:
    database = Database(database_url)
    asyncio.run(install_warehouse(database, warehouse(seed=1), START_S))
    database.close_now()
    running = ServerProcess(database_url, tmp_path / "server.log")
    running.start()
    yield running
    running.kill()


def observed() -> list[Observation]:
    return walk(warehouse(seed=1), seed=4, start_s=START_S, duration_s=18.0).observations


def bodies_of(device_id: str, groups: list[list[Observation]], **fields: str) -> list[Batch]:
    shared = {**header(device_id, warehouse(seed=1).site.site_id), **fields}
    return numbered(shared, groups)


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
    batches = bodies_of("picker", by_second(observed()))
    assert post_all(server, batches[:6])["profile"] == "best"
    patch(server, site, default_profile=OTHER)
    fix = post_all(server, batches[6:7])
    assert fix["profile"] == OTHER
    with server.client() as client:
        assert client.get("/v1/devices/picker/fix").json()["fix"] == fix
    server.kill()
    server.start()
    assert post_all(server, batches[7:12])["profile"] == OTHER
    patch(server, "/v1/devices/picker", profile="best")
    assert post_all(server, batches[12:])["profile"] == "best"

    # Two phones that walk alike and name their profile do not care for the site's.
    for profile in ("best", OTHER):
        whole = bodies_of(profile, [observed()], profile=profile)
        assert post_all(server, whole)["profile"] == profile
    switched = track_of(server, "picker")
    always = {profile: track_of(server, profile) for profile in ("best", OTHER)}
    profiles = [point["profile"] for point in switched]
    first = profiles.index(OTHER)
    second = profiles.index("best", first)
    begin, end = switched[first]["time"], switched[second]["time"]
    assert switched == [
        *(p for p in always["best"] if p["time"] < begin),
        *(p for p in always[OTHER] if begin <= p["time"] < end),
        *(p for p in always["best"] if p["time"] >= end),
    ]
    assert min(first, second - first, len(switched) - second) >= 4
