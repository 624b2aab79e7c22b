"""Uploads that are meant to do harm come to nothing, and phones are matched as before."""

import asyncio
import gzip
import io
import zipfile

import pytest
from api_server import ApiServer

from app.core.fingerprint.radio_map import Fingerprint, build_radio_map
from app.storage.radio_maps import RadioMapOrigin, save_radio_map

pytestmark = pytest.mark.anyio

HEADER = "point,floor_id,x,y,kind,key,rssi_dbm\n"
GOOD = HEADER + "P1,lab-0,1,5,wifi,mac:aabbccddee01,-50\n"


def outside() -> bytes:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as out:
        out.writestr("good.csv", GOOD)
        out.writestr("../../pharos.db", GOOD)
    return archive.getvalue()


HOSTILE = {
    "bomb": (gzip.compress(GOOD.encode() + (b"x" * 500_000 + b"\n") * 80), "grows more than"),
    "outside": (outside(), "outside of itself"),
    "truncated": (gzip.compress(GOOD.encode() * 2_000)[:-9], "cut off"),
    "formulas": ((HEADER + "=1+1,lab-0,1,5,wifi,mac:aabbccddee01,-50\n").encode(), "nothing in it"),
}


async def activate_map(server: ApiServer) -> str:
    radio_map = build_radio_map(
        ("lab-0",), [Fingerprint(0, 1.0, 5.0, {"mac:aabbccddee01": -50.0}, {}, "w")]
    )
    origin = RadioMapOrigin("spring", server.clock.now_s())
    context = server.app.state.context
    stored = await context.database.write(
        lambda c: save_radio_map(c, "lab", radio_map, origin, activate=True)
    )
    await context.directory.refresh()
    return stored.radio_map_id


async def ended(client, job_id: str) -> dict:
    while True:
        job = (await client.get(f"/v1/jobs/{job_id}")).json()
        if job["ended"] is not None:
            return job
        await asyncio.sleep(0.02)


async def test_hostile_uploads_fail_and_the_old_map_stays_active(server: ApiServer):
    active = await activate_map(server)
    before = server.app.state.context.directory.current("lab").radio_map
    async with server.client("surveyor") as client:
        for body, words in HOSTILE.values():
            sent = await client.post("/v1/surveys?site_id=lab", content=body)
            job = await ended(client, sent.json()["job_id"])
            assert (job["state"], job["problem"]["code"]) == ("failed", "nothing_usable")
            assert words in job["problem"]["detail"]
        assert (await client.get("/v1/surveys?site_id=lab")).json()["items"] == []
        listed = (await client.get("/v1/radio-maps?site_id=lab")).json()["items"]
    assert [(m["radio_map_id"], m["active"]) for m in listed] == [(active, True)]
    await server.app.state.context.directory.refresh()
    assert server.app.state.context.directory.current("lab").radio_map is before
    uploads = server.app.state.context.uploads
    await uploads.settle()
    assert list(uploads.spool.folder.iterdir()) == []
