"""``pharos survey list``: the surveys of this machine's database."""

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from app.cli.local import EVERY_ROW, DatabaseOption, SiteFilter, local_database
from app.cli.tables import minute_of
from app.storage import surveys


def list_surveys(
    site: SiteFilter = None,
    database: DatabaseOption = None,
) -> None:
    """List surveys, the newest first."""
    with local_database(database) as store:
        stored = store.read_now(lambda c: surveys.list_surveys(c, site_id=site, limit=EVERY_ROW))
    table = Table()
    table.add_column("id", no_wrap=True)
    for heading in ("site", "name", "format", "floors", "walks", "fingerprints", "created"):
        table.add_column(heading, overflow="fold")
    for one in stored:
        held = one.holdings
        table.add_row(
            one.survey_id,
            one.site_id,
            escape(one.name),
            one.survey_format,
            " ".join(holding.floor_id for holding in held),
            str(sum(holding.walks for holding in held)),
            str(sum(holding.fingerprints for holding in held)),
            minute_of(one.created_s),
        )
    Console().print(table)
