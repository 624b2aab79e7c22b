"""What an upload of half a gigabyte costs: time, and memory of the server and of its reader.

Run ``python benchmarks/survey_upload.py [MEGABYTES]``. A wide table is made while it is sent, to a
server of its own over a new SQLite file; memory is the peak of the resident set of each process.
"""

import asyncio
import multiprocessing
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import uvicorn

from app.config import Settings
from app.main import create_app, uvicorn_options
from app.services.access import Role
from app.services.issue_tokens import TokenGrant, issue_token
from app.storage import migrate
from app.storage.database import Database

COLUMNS = 520
HEADER = ",".join([*(f"WAP{i:03}" for i in range(COLUMNS)), "X", "Y", "FLOOR"]) + "\n"
ROWS_PER_PIECE = 100


async def table(size: int) -> AsyncIterator[bytes]:
    """Yield a wide table of about ``size`` bytes: 60 access points heard of 520 in each row."""
    yield HEADER.encode()
    sent, row = len(HEADER), 0
    while sent < size:
        lines = []
        for _ in range(ROWS_PER_PIECE):
            heard = [
                str(-40 - (row + i) % 50) if i % 9 == row % 9 else "100" for i in range(COLUMNS)
            ]
            lines.append(",".join([*heard, str(row % 60), str(row % 40), "Ground"]))
            row += 1
        piece = ("\n".join(lines) + "\n").encode()
        sent += len(piece)
        yield piece


def peak_mb(pid: int | str) -> float:
    """Return the peak of a process's resident set so far."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    return int(status.split("VmHWM:")[1].split()[0]) / 1024.0


async def measure(port: int, token: str, megabytes: int) -> None:
    """Upload, watch, and print what it took."""
    client = httpx.AsyncClient(
        base_url=f"http://127.0.0.1:{port}",
        headers={"Authorization": f"Bearer {token}"},
        timeout=600.0,
    )
    async with client:
        await client.post("/v1/sites", json={"site_id": "hall", "name": "Hall"})
        floor = {"floor_id": "hall-0", "site_id": "hall", "name": "Ground", "ordinal": 0}
        await client.post("/v1/floors", json={**floor, "width": 60, "height": 40})
        start_s = time.perf_counter()
        reply = await client.post("/v1/surveys?site_id=hall", content=table(megabytes << 20))
        sent_s = time.perf_counter() - start_s
        job, reader_mb, slowest_s = reply.json(), 0.0, 0.0
        while job["state"] not in {"done", "failed"}:
            await asyncio.sleep(0.2)
            asked_s = time.perf_counter()
            job = (await client.get(f"/v1/jobs/{reply.json()['job_id']}")).json()
            slowest_s = max(slowest_s, time.perf_counter() - asked_s)
            for child in multiprocessing.active_children():
                reader_mb = max(reader_mb, peak_mb(child.pid or "self"))
        print(f"{job['state']}: {job['progress']}")
        print(f"received in {sent_s:.0f} s, read in {time.perf_counter() - start_s - sent_s:.0f} s")
        print(f"peak memory: server {peak_mb('self'):.0f} MB, reader {reader_mb:.0f} MB")
        print(f"slowest other request meanwhile: {1000 * slowest_s:.0f} ms")


async def main() -> None:
    """Serve and upload."""
    megabytes = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    with tempfile.TemporaryDirectory(dir=".") as folder:
        url = f"sqlite:///{folder}/pharos.db"
        migrate.upgrade(url)
        database = Database(url)
        token, _ = await issue_token(database, TokenGrant("benchmark", Role.ADMIN), 0.0)
        await database.close()
        settings = Settings(database_url=url, port=8765, log_level="warning", spool_dir=folder)
        server = uvicorn.Server(uvicorn.Config(create_app(settings), **uvicorn_options(settings)))
        serving = asyncio.create_task(server.serve())
        while not server.started:
            if serving.done():
                return
            await asyncio.sleep(0.1)
        await measure(settings.port, token, megabytes)
        server.should_exit = True
        await serving


if __name__ == "__main__":
    asyncio.run(main())
