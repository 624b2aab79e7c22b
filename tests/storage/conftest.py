"""Fixtures of the storage tests: a real database of either kind, with one site and its sessions."""

from collections.abc import AsyncIterator

import pytest
from sqlalchemy import insert

from app.storage.database import Database
from app.storage.tables import FLOORS, SITES

SITE = {"id": "site-1", "name": "Warehouse", "created_s": 0.0}
FLOOR = {"site_id": "site-1", "ordinal": 0, "x0_m": 0, "y0_m": 0, "width_m": 60, "height_m": 40}


@pytest.fixture
async def database(storage_url: str) -> AsyncIterator[Database]:
    opened = Database(storage_url)
    yield opened
    await opened.close()


@pytest.fixture
async def site(database: Database) -> str:
    """Store a site with the floors F1 and F2."""
    floors = [{**FLOOR, "id": name, "name": name} for name in ("F1", "F2")]
    await database.write(lambda c: c.execute(insert(SITES), SITE).close())
    await database.write(lambda c: c.execute(insert(FLOORS), floors).close())
    return "site-1"
