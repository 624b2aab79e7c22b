"""The dashboard as files: served offline, versioned, with the right types and a strict policy."""

import re
from collections.abc import AsyncIterator

import httpx
import pytest
from fastapi import FastAPI

from app.web.assets import load_assets
from app.web.pages import mount_web

pytestmark = pytest.mark.anyio


@pytest.fixture
async def client() -> AsyncIterator[httpx.AsyncClient]:
    app = FastAPI()
    mount_web(app)
    transport = httpx.ASGITransport(app=app)
    async with httpx.AsyncClient(transport=transport, base_url="http://pharos") as client:
        yield client


async def test_every_file_the_page_names_is_served_under_the_version(
    client: httpx.AsyncClient,
) -> None:
    page = (await client.get("/")).text
    named = re.findall(r'(?:href|src)="(/static/[^"]+)"', page)
    assert len(named) >= 6
    for url in named:
        assert url.startswith(f"/static/{load_assets().version}/")
        assert (await client.get(url)).status_code == 200


def test_every_module_imports_only_modules_that_are_served() -> None:
    modules = {
        path: asset.content.decode()
        for path, asset in load_assets().by_path.items()
        if path.startswith("js/")
    }
    for path, source in modules.items():
        for target in re.findall(r'from "([^"]+)"', source):
            assert target.startswith(("./", "../leaflet/")), (path, target)
            served = target.removeprefix("../") if target.startswith("../") else f"js/{target[2:]}"
            assert served in load_assets().by_path, (path, target)


@pytest.mark.parametrize(
    ("suffix", "media_type"),
    [(".js", "text/javascript"), (".css", "text/css"), (".svg", "image/svg+xml")],
)
async def test_media_types_do_not_depend_on_the_machine(
    client: httpx.AsyncClient, suffix: str, media_type: str
) -> None:
    assets = load_assets()
    paths = [path for path in assets.by_path if path.endswith(suffix)]
    assert paths
    for path in paths:
        response = await client.get(f"/static/{assets.version}/{path}")
        assert response.headers["content-type"].partition(";")[0] == media_type
        assert "immutable" in response.headers["cache-control"]


async def test_policy_lets_nothing_in_from_elsewhere(client: httpx.AsyncClient) -> None:
    response = await client.get("/")
    policy = dict(
        part.split(" ", 1) for part in response.headers["content-security-policy"].split("; ")
    )
    assert policy.pop("default-src") == "'none'"
    assert set(policy.values()) <= {"'self'", "'none'"}
    assert response.headers["x-content-type-options"] == "nosniff"
    assert response.headers["cache-control"] == "no-cache"


def test_nothing_refers_to_another_host() -> None:
    own = {p: a for p, a in load_assets().by_path.items() if not p.startswith("leaflet/")}
    for path, asset in own.items():
        hosts = re.findall(r"https?://[^\s\"'<>]+", asset.content.decode())
        assert [host for host in hosts if host != "http://www.w3.org/2000/svg"] == [], path


@pytest.mark.parametrize("path", ["js/absent.js", "../pages.py", "leaflet/leaflet.js"])
async def test_files_outside_the_page_are_not_served(client: httpx.AsyncClient, path: str) -> None:
    response = await client.get(f"/static/{load_assets().version}/{path}")
    assert response.status_code == 404


async def test_another_version_is_another_path(client: httpx.AsyncClient) -> None:
    assert (await client.get("/static/000000000000/js/main.js")).status_code == 404
