"""HEAD answers as GET does, without the content."""

import httpx
import pytest
from api_server import NOW_S, ApiServer, batch, ble_record

pytestmark = pytest.mark.anyio

OF_ITS_REQUEST = {"x-request-id", "date"}


def headers_of(reply: httpx.Response) -> dict[str, str]:
    return {name: value for name, value in reply.headers.items() if name not in OF_ITS_REQUEST}


@pytest.mark.parametrize(
    "path",
    [
        *("/healthz", "/v1/sites", "/v1/floors/lab-0", "/v1/beacons/export?site_id=lab"),
        *("/v1/devices/phone-7/fix", "/v1/devices/phone-7/track", "/openapi.json", "/"),
        *("/v1/floors/none", "/v1/login", "/nowhere"),
    ],
)
async def test_head_is_get_without_the_content(server: ApiServer, path: str) -> None:
    async with server.client() as admin:
        await admin.post("/v1/ingest", json=batch(ble_record(6, 4, NOW_S * 1000), site="lab"))
        got, head = await admin.get(path), await admin.head(path)
    assert head.status_code == got.status_code
    assert headers_of(head) == headers_of(got)
    assert (head.content, bool(got.content)) == (b"", True)


async def test_head_is_conditional_and_asks_for_a_token(server: ApiServer) -> None:
    async with server.client() as admin, server.client(None) as nobody:
        etag = (await admin.head("/v1/floors/lab-0")).headers["ETag"]
        held = await admin.head("/v1/floors/lab-0", headers={"If-None-Match": etag})
        assert held.status_code == 304
        assert (await nobody.head("/v1/floors/lab-0")).status_code == 401


async def test_openapi_describes_get_alone(server: ApiServer) -> None:
    document = server.app.openapi()
    assert not [path for path, operations in document["paths"].items() if "head" in operations]
