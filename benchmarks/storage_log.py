"""What the group commit of the observation log is worth, against one commit for every batch.

Run ``python benchmarks/storage_log.py [DATABASE_URL]`` (an empty database; default: a new SQLite
file in the working directory, so that the disk measured is the one that will be used).
"""

import asyncio
import sys
import tempfile
import time

from sqlalchemy import insert

from app.core.session import LoggedBatch, SessionClock, SessionRecord
from app.core.types import Reading, WifiScan
from app.storage import migrate
from app.storage.database import Database
from app.storage.log import SqlObservationLog
from app.storage.tables import SITES

PHONES = 64
BATCHES_PER_PHONE = 20
READINGS = 30


def batch(session_id: str, seq: int) -> LoggedBatch:
    """Return a batch with one Wi-Fi scan."""
    readings = tuple(Reading((f"mac:{i:012x}",), -60.0 - i) for i in range(READINGS))
    return LoggedBatch(session_id, seq, b"digest", float(seq), (WifiScan(float(seq), readings),))


async def batches_per_s(url: str, round_name: str, group_limit: int) -> float:
    """Return the acknowledged batches per second of phones that each wait for their answer."""
    database = Database(url, group_limit=group_limit)
    log = SqlObservationLog(database, limit_s=60.0)
    names = [f"{round_name}-{i}" for i in range(PHONES)]
    for name in names:
        await log.open_session(
            SessionRecord(name, name, name, "site", "best", SessionClock(), opened_s=0.0)
        )

    async def phone(name: str) -> None:
        for seq in range(BATCHES_PER_PHONE):
            await log.append(batch(name, seq), SessionClock())

    start_s = time.perf_counter()
    await asyncio.gather(*map(phone, names))
    elapsed_s = time.perf_counter() - start_s
    await database.close()
    return PHONES * BATCHES_PER_PHONE / elapsed_s


def main() -> None:
    """Measure both in one run and print the ratio."""
    with tempfile.TemporaryDirectory(dir=".") as folder:
        url = sys.argv[1] if len(sys.argv) > 1 else f"sqlite:///{folder}/benchmark.db"
        migrate.upgrade(url)
        database = Database(url)
        site = {"id": "site", "name": "Benchmark", "created_s": 0.0}
        database.write_now(lambda c: c.execute(insert(SITES), site).close())
        database.close_now()
        asyncio.run(batches_per_s(url, "warm-up", 256))
        single = asyncio.run(batches_per_s(url, "single", 1))
        grouped = asyncio.run(batches_per_s(url, "grouped", 256))
    print(f"{PHONES} phones: one commit per batch {single:.0f}/s, group commit {grouped:.0f}/s")
    print(f"ratio {grouped / single:.1f}")


if __name__ == "__main__":
    main()
