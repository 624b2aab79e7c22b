"""Fixtures and rules of the whole suite."""

from collections.abc import Generator
from pathlib import Path

import pytest

SHARED = Path(__file__).parents[2] / "shared"


@pytest.fixture
def anyio_backend() -> str:
    """Async tests run on asyncio."""
    return "asyncio"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of public data sets that lies beside a development checkout."""
    folder = SHARED / "data"
    if not folder.is_dir():
        pytest.skip(f"no data sets in {Path('..') / 'shared' / 'data'}")
    return folder


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """With the data sets there, a data test that skips has failed."""
    report = yield
    needs_data = item.get_closest_marker("shared_data") or "shared_data" in getattr(
        item, "fixturenames", ()
    )
    if report.skipped and needs_data and SHARED.is_dir() and not hasattr(report, "wasxfail"):
        report.outcome = "failed"
        report.longrepr = f"the data sets are there, yet the test skipped: {report.longrepr}"
    return report
