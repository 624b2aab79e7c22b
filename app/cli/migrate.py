"""``pharos migrate``: bring the database to the schema of this version."""

from rich.console import Console
from sqlalchemy.exc import SQLAlchemyError

from app.cli.local import DatabaseOption, database_error, settings_with
from app.storage.migrate import current, upgrade


def migrate(database: DatabaseOption = None) -> None:
    """Bring the database to the schema of this version; it is safe to run it again."""
    url = settings_with(database_url=database).database_url
    try:
        before = current(url)
        upgrade(url)
        after = current(url)
    except (SQLAlchemyError, ValueError) as error:
        raise database_error(url, error) from error
    if before == after:
        Console().print(f"Nothing to do: the schema is at {after}.")
    else:
        Console().print(f"The schema went from {before or 'nothing'} to {after}.")
