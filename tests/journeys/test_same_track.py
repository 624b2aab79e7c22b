"""A simulated phone's walk leaves one track, however it is posted; with a server that is killed."""

import asyncio
from collections.abc import Iterator
from typing import Any

import pytest
from same_track import WAYS, reference_track, track_posted
from server_process import ServerProcess

from app.core.simulate import SimulatedWalk, Warehouse, walk, warehouse
from app.services.demo import install_warehouse
from app.storage.database import Database
from app.storage.migrate import upgrade

START_S = 1_763_769_600.0
DURATION_S = 45.0


@pytest.fixture(scope="module")
def world() -> Warehouse:
    return warehouse(seed=1)


@pytest.fixture(scope="module")
def walked(world: Warehouse) -> SimulatedWalk:
    return walk(world, seed=4, start_s=START_S, duration_s=DURATION_S, imu=True)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, world: Warehouse) -> Iterator[ServerProcess]:
    folder = tmp_path_factory.mktemp("journey")
    url = f"sqlite:///{folder / 'pharos.db'}"
    upgrade(url)
    database = Database(url)
    asyncio.run(install_warehouse(database, world, START_S))
    database.close_now()
    process = ServerProcess(url, folder / "server.log")
    process.start()
    yield process
    process.kill()


@pytest.fixture(scope="module")
def plain(server: ServerProcess, world: Warehouse, walked: SimulatedWalk) -> list[dict[str, Any]]:
    track = reference_track(server, world.site.site_id, walked.observations)
    assert len(track) > 0.9 * DURATION_S
    return track


@pytest.mark.parametrize("way", WAYS)
def test_the_same_walk_leaves_the_same_track(
    way: str,
    server: ServerProcess,
    world: Warehouse,
    walked: SimulatedWalk,
    plain: list[dict[str, Any]],
) -> None:
    assert track_posted(way, server, world.site.site_id, walked.observations) == plain
