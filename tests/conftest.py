"""Fixtures and rules of the whole suite."""

import itertools
import shutil
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import pytest
from postgres_server import running_postgres
from server_process import ServerProcess
from sqlalchemy import create_engine, make_url, text

from app.storage import migrate

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


@pytest.fixture(scope="session")
def new_postgres_url() -> Iterator[Callable[[str | None], str]]:
    """Return a function that creates a database (of a template's name, None: empty)."""
    numbers = itertools.count()
    with running_postgres() as server:
        admin = create_engine(
            server.format(database="postgres"), isolation_level="AUTOCOMMIT", max_overflow=0
        )

        def create(template: str | None) -> str:
            name = f"test_{next(numbers)}"
            copied = "" if template is None else f" TEMPLATE {template} STRATEGY file_copy"
            with admin.connect() as connection:
                connection.execute(text(f"CREATE DATABASE {name}{copied}"))
            return server.format(database=name)

        yield create
        admin.dispose()


@pytest.fixture(scope="session")
def _postgres_template(new_postgres_url: Callable[[str | None], str]) -> str:
    url = new_postgres_url(None)
    migrate.upgrade(url)
    name = make_url(url).database
    assert name is not None
    return name


@pytest.fixture
def postgres_url(new_postgres_url: Callable[[str | None], str], _postgres_template: str) -> str:
    """Return the URL of a fresh, migrated PostgreSQL database."""
    return new_postgres_url(_postgres_template)


@pytest.fixture(scope="session")
def _sqlite_template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sqlite") / "template.db"
    migrate.upgrade(f"sqlite:///{path}")
    return path


@pytest.fixture
def database_url(_sqlite_template: Path, tmp_path: Path) -> str:
    """Return the URL of a fresh, migrated SQLite database."""
    path = shutil.copy(_sqlite_template, tmp_path / "pharos.db")
    return f"sqlite:///{path}"


@pytest.fixture(params=["sqlite", pytest.param("postgres", marks=pytest.mark.postgres)])
def storage_url(request: pytest.FixtureRequest) -> str:
    """Return the URL of a fresh, migrated database, of either kind in turn."""
    kind = "database_url" if request.param == "sqlite" else "postgres_url"
    url: str = request.getfixturevalue(kind)
    return url


@pytest.fixture
def live_server(database_url: str, tmp_path: Path) -> Iterator[ServerProcess]:
    """Return a real server over a fresh database, started; it can be killed and started again."""
    server = ServerProcess(database_url, tmp_path / "server.log")
    server.start()
    yield server
    server.kill()
