"""Alembic's entry: runs migrations on the connection it is given, or on the URL of alembic.ini."""

from alembic import context
from sqlalchemy import Connection

from app.storage.engines import migrating_engine
from app.storage.tables import METADATA


def run(connection: Connection) -> None:
    """Run the migrations; the caller owns the transaction."""
    context.configure(connection=connection, target_metadata=METADATA, render_as_batch=True)
    with context.begin_transaction():
        context.run_migrations()


given = context.config.attributes.get("connection")
if given is not None:
    run(given)
else:
    with migrating_engine(context.config.get_main_option("sqlalchemy.url") or "").begin() as own:
        run(own)
