"""A running application for each test that asks for one."""

from collections.abc import AsyncIterator

import pytest
from api_server import ApiServer, serving


@pytest.fixture
def server_url(request: pytest.FixtureRequest) -> str:
    """Return the URL of a fresh, migrated database: SQLite, or what `on_both_databases` says."""
    url: str = request.getfixturevalue(getattr(request, "param", "database_url"))
    return url


@pytest.fixture
async def server(server_url: str, anyio_backend: str) -> AsyncIterator[ApiServer]:
    """Return the application over a fresh database."""
    async with serving(server_url) as running:
        yield running
