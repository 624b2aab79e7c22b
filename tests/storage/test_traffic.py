"""The traffic that ageing looks at: scans of a site in event time, whichever clock timed them."""

from dataclasses import replace

import pytest
from sample_sessions import CLOCK, imu_block, logged_batch, session_record, wifi_scan

from app.storage.ageing import traffic
from app.storage.database import Database
from app.storage.log import SqlObservationLog

pytestmark = pytest.mark.anyio


async def test_traffic_is_in_event_time_and_in_order(database: Database, site: str):
    log = SqlObservationLog(database)
    await log.open_session(session_record())
    wall_s = CLOCK.mono_to_wall_s
    assert wall_s is not None
    # By its own number the monotonic one would come first.
    by_mono = replace(logged_batch(1, wifi_scan(50.0), imu_block(51.0)), monotonic=(True, False))
    for batch in (logged_batch(0, wifi_scan(wall_s + 20.0)), by_mono):
        await log.append(batch, CLOCK)
    (session,) = await database.read(lambda c: traffic(c, site, 0.0))
    assert [scan.time_s for scan in session] == pytest.approx([wall_s + 20.0, wall_s + 50.0])
    assert await database.read(lambda c: traffic(c, site, 2e9)) == []
