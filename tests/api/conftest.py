"""A running application for each test that asks for one."""

from collections.abc import AsyncIterator

import pytest
from api_server import ApiServer, serving


@pytest.fixture
async def server(database_url: str, anyio_backend: str) -> AsyncIterator[ApiServer]:
    """Return the application over a fresh database."""
    async with serving(database_url) as running:
        yield running
