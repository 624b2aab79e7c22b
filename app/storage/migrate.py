"""Bring a database to the schema of this build."""

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection

from app.storage.engines import migrating_engine

# Any constant does, if nothing else in the database uses it: "pharos" in a telephone's digits.
_POSTGRES_LOCK = 742767


def upgrade(url: str, revision: str = "head") -> None:
    """Upgrade to a revision in one transaction; of several processes one does it, others wait."""
    engine = migrating_engine(url)
    with engine.begin() as connection:
        _lock(connection)
        command.upgrade(_config(connection), revision)
        _check_foreign_keys(connection)
    engine.dispose()


def downgrade(url: str, revision: str) -> None:
    """Downgrade to a revision in one transaction (``base``: drop everything)."""
    engine = migrating_engine(url)
    with engine.begin() as connection:
        _lock(connection)
        command.downgrade(_config(connection), revision)
        _check_foreign_keys(connection)
    engine.dispose()


def current(url: str) -> str | None:
    """Return the revision a database is at, None before the first."""
    engine = migrating_engine(url)
    with engine.connect() as connection:
        revision = MigrationContext.configure(connection).get_current_revision()
    engine.dispose()
    return revision


def head() -> str | None:
    """Return the revision that this build needs."""
    return ScriptDirectory(str(scripts_folder())).get_current_head()


def scripts_folder() -> Path:
    """Return the folder of the migrations: inside an installed wheel, or of the checkout."""
    bundled = Path(__file__).parent / "migrations_bundle"
    return bundled if bundled.is_dir() else Path(__file__).parents[2] / "migrations"


def _config(connection: Connection) -> Config:
    config = Config(attributes={"connection": connection})
    # Config values are interpolated: a per cent sign in the path must not be.
    config.set_main_option("script_location", str(scripts_folder()).replace("%", "%%"))
    return config


def _lock(connection: Connection) -> None:
    """Hold others off until the transaction ends; SQLite's BEGIN IMMEDIATE did so already."""
    if connection.dialect.name == "postgresql":
        connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({_POSTGRES_LOCK})")


def _check_foreign_keys(connection: Connection) -> None:
    if connection.dialect.name == "sqlite":
        broken = connection.exec_driver_sql("PRAGMA foreign_key_check").all()
        if broken:
            msg = f"the migration left rows without the row they refer to: {broken[:5]}"
            raise RuntimeError(msg)
