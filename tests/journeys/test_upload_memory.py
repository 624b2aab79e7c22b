"""A large upload costs the server no more memory than a small one."""

import gzip
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from server_process import ServerProcess
from survey_files import MACS, T0_MS

MEMBERS = 64
GROWTH_MB = 16.0
"""Measured 3; whoever keeps the body has 26 more."""
READER_MB = 190.0
"""Measured 142, nearly all of it Python and its packages; the file's content has 70."""
LIMIT_S = 100.0


def trace() -> bytes:
    """Return a walk of a megabyte, most of it readings of a sensor that nobody needs."""
    rng = np.random.default_rng(1)
    lines = [f"#\tstartTime:{T0_MS}", "#\tSiteID:x\tSiteName:Hall\tFloorId:y\tFloorName:F1"]
    for second in range(11):
        t_ms = T0_MS + 1000 * second
        lines += [f"{t_ms}\tTYPE_WIFI\tn\t{mac}\t-50\t2412\t{t_ms - 100}" for mac in MACS]
        lines += [f"{t_ms}\tTYPE_WAYPOINT\t{1 + second}\t5"] if second % 5 == 0 else []
        lines += [
            f"{t_ms}\tTYPE_MAGNETIC_FIELD_UNCALIBRATED\t" + "\t".join(map(str, row)) + "\t3"
            for row in rng.uniform(-99.0, 99.0, (600, 6)).tolist()
        ]
    return ("\n".join(lines) + "\n").encode()


def pieces(member: bytes) -> Iterator[bytes]:
    """Yield a file of gzip members, made while it is sent."""
    for _ in range(MEMBERS):
        yield member


def status_mb(pid: int, name: str) -> float:
    """Return a line of a process's status; 0 once it has ended."""
    try:
        status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    except FileNotFoundError:
        return 0.0
    _, _, rest = status.partition(f"{name}:")
    return int(rest.split()[0]) / 1024.0 if rest else 0.0


def children(pid: int) -> list[int]:
    """Return the processes that any thread of a process has begun."""
    told = [p.read_text(encoding="ascii") for p in Path(f"/proc/{pid}/task").glob("*/children")]
    return [int(child) for children_ids in told for child in children_ids.split()]


@pytest.mark.timeout(240)
def test_memory_stays_bounded_while_a_large_survey_is_received_and_read(
    live_server: ServerProcess,
) -> None:
    plain = trace()
    member = gzip.compress(plain, 1)
    assert len(member) * MEMBERS > 1.5 * GROWTH_MB * 2**20
    assert 50e6 < len(plain) * MEMBERS < 100e6
    with live_server.client() as client:
        client.post("/v1/sites", json={"site_id": "hall", "name": "Hall"}).raise_for_status()
        floor = {"floor_id": "hall-0", "site_id": "hall", "name": "F1", "ordinal": 0}
        client.post("/v1/floors", json={**floor, "width": 20, "height": 10}).raise_for_status()
        Path(f"/proc/{live_server.pid}/clear_refs").write_text("5", encoding="ascii")
        before_mb = status_mb(live_server.pid, "VmHWM")
        start_s = time.monotonic()
        sent = client.post("/v1/surveys?site_id=hall", content=pieces(member)).raise_for_status()
        job, reader_mb = sent.json(), 0.0
        while job["ended"] is None:
            assert time.monotonic() < start_s + LIMIT_S, job
            peaks = [status_mb(child, "VmHWM") for child in children(live_server.pid)]
            reader_mb = max([reader_mb, *peaks])
            time.sleep(0.05)
            job = client.get(f"/v1/jobs/{job['job_id']}").json()
        grown_mb = status_mb(live_server.pid, "VmHWM") - before_mb
    assert (job["state"], job["progress"]["traces"]) == ("done", MEMBERS)
    assert grown_mb < GROWTH_MB
    assert 0.0 < reader_mb < READER_MB
