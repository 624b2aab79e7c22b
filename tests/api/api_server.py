"""The real application over ASGI: a fresh database, a clock we move, a small room, tokens.

The room "lab" has one floor of 20 m x 10 m with five BLE beacons; "annex" is a second, empty site.
"""

import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

import httpx
import pytest
from fastapi import FastAPI
from server_process import PATIENCE
from sqlalchemy import Connection

from app.config import Settings
from app.main import create_app
from app.services.access import Role
from app.services.issue_tokens import TokenGrant, token_of
from app.services.tokens import new_token
from app.storage.beacons import StoredBeacon, insert_beacon
from app.storage.database import Database
from app.storage.floors import StoredFloor, insert_floor
from app.storage.sites import StoredSite, insert_site
from app.storage.tokens import create_token, revoke_token

on_both_databases = pytest.mark.parametrize(
    "server_url",
    ["database_url", pytest.param("postgres_url", marks=pytest.mark.postgres)],
    indirect=True,
    ids=["sqlite", "postgres"],
)
"""The main path of a service: what it stores and finds again is the same on either database."""

NOW_S = 1_795_314_001.0
UUID = "f7826da6-4fa2-4e98-8024-bc5b71e0893e"
BEACONS = {1: (0.0, 0.0), 2: (20.0, 0.0), 3: (20.0, 10.0), 4: (0.0, 10.0), 5: (10.0, 5.0)}

GRANTS = {
    "admin": TokenGrant("admin", Role.ADMIN),
    "supervisor": TokenGrant("supervisor", Role.SUPERVISOR),
    "surveyor": TokenGrant("surveyor", Role.SURVEYOR),
    "viewer": TokenGrant("viewer", Role.VIEWER),
    "phone-7": TokenGrant("phone-7", Role.DEVICE, site_id="lab", device_id="phone-7"),
    "fleet": TokenGrant("fleet", Role.DEVICE, site_id="lab", device_prefix="fleet-"),
    "annex-viewer": TokenGrant("annex-viewer", Role.VIEWER, site_id="annex"),
    "annex-surveyor": TokenGrant("annex-surveyor", Role.SURVEYOR, site_id="annex"),
    "expired": TokenGrant("expired", Role.ADMIN, expires_s=NOW_S - 1.0),
    "revoked": TokenGrant("revoked", Role.ADMIN),
}


@dataclass
class MovableClock:
    """A clock that stands still until it is moved."""

    time_s: float = NOW_S

    def now_s(self) -> float:
        return self.time_s


@dataclass
class ApiServer:
    """The running application and the secrets of `GRANTS`."""

    app: FastAPI
    clock: MovableClock
    secrets: dict[str, str] = field(default_factory=dict)

    def client(self, bearer: str | None = "admin") -> httpx.AsyncClient:
        """Return a client with the token of that name; None: without one."""
        headers = {} if bearer is None else {"Authorization": f"Bearer {self.secrets[bearer]}"}
        transport = httpx.ASGITransport(self.app, raise_app_exceptions=False)
        return httpx.AsyncClient(
            transport=transport, base_url="http://pharos.test", headers=headers
        )


def fill(database_url: str) -> dict[str, str]:
    """Store the room and the tokens; return the secrets by name."""
    secrets = {name: new_token() for name in GRANTS}
    database = Database(database_url)
    database.write_now(lambda connection: _fill(connection, secrets))
    database.close_now()
    return secrets


@asynccontextmanager
async def serving(database_url: str, **settings: object) -> AsyncIterator[ApiServer]:
    """Run the application over a migrated database."""
    clock = MovableClock()
    secrets = fill(database_url)
    chosen = {**PATIENCE, **settings}
    app = create_app(Settings(database_url=database_url, migrate=False, **chosen), clock)
    async with app.router.lifespan_context(app):
        yield ApiServer(app, clock, secrets)


def ble_record(x_m: float, y_m: float, t_ms: float, **fields: object) -> dict[str, object]:
    """Return what a phone at (x, y) hears of the room's beacons, without noise."""
    beacons = []
    for minor, (bx, by) in BEACONS.items():
        distance_m = math.sqrt((bx - x_m) ** 2 + (by - y_m) ** 2 + 1.5**2)
        beacons.append(
            {
                "ibeacon": {"uuid": UUID, "major": 1, "minor": minor},
                "rssi": round(-59.0 - 20.0 * math.log10(distance_m), 1),
            }
        )
    return {"k": "ble", "t_ms": t_ms, "beacons": beacons, **fields}


def batch(*records: object, seq: int = 0, **fields: object) -> dict[str, object]:
    """Return an ingest body of phone-7."""
    return {
        "device": {"id": "phone-7"},
        "session": "walk-1",
        "seq": seq,
        "records": list(records),
        **fields,
    }


def _fill(connection: Connection, secrets: dict[str, str]) -> None:
    for site_id in ("lab", "annex"):
        insert_site(connection, StoredSite(site_id, site_id.title(), 0.0))
    insert_floor(connection, StoredFloor("lab-0", "lab", "Ground", 0, 20.0, 10.0))
    for minor, (x_m, y_m) in BEACONS.items():
        beacon = StoredBeacon(
            beacon_id=f"b{minor}",
            site_id="lab",
            kind="ble",
            keys=(f"ibeacon:{UUID}:1:{minor}",),
            floor_id="lab-0",
            x_m=x_m,
            y_m=y_m,
            z_m=2.7,
        )
        insert_beacon(connection, beacon)
    for name, grant in GRANTS.items():
        stored = create_token(connection, token_of(grant, secrets[name], 0.0))
        if name == "revoked":
            revoke_token(connection, stored.token_id, 0.0)
