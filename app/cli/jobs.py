"""``pharos jobs``: long work of the server, as this machine's database tells it."""

from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from app.cli.local import DatabaseOption, SiteFilter, local_database
from app.cli.tables import minute_of
from app.storage.jobs import JobsAsked, StoredJob, list_jobs


def jobs(
    site: SiteFilter = None,
    kind: Annotated[
        str | None, typer.Option(metavar="KIND", help="As the list tells it: survey import, say.")
    ] = None,
    state: Annotated[
        str | None,
        typer.Option(metavar="STATE", help="receiving, waiting, running, done or failed."),
    ] = None,
    limit: Annotated[int, typer.Option(min=1, max=10_000, help="How many at most.")] = 20,
    database: DatabaseOption = None,
) -> None:
    """List long work (uploads, builds of radio maps, looks at growth), the newest first."""
    asked = JobsAsked(site, kind, state)
    with local_database(database) as store:
        # One more than asked for says that there is a next page.
        found = store.read_now(lambda c: list_jobs(c, asked, after=None, limit=limit))[:limit]
    table = Table()
    table.add_column("id", no_wrap=True)
    for heading in ("site", "kind", "state", "what came of it", "created"):
        table.add_column(heading, overflow="fold")
    for job in found:
        came = escape(_outcome(job))
        table.add_row(job.job_id, job.site_id, job.kind, job.state, came, minute_of(job.created_s))
    Console().print(table)


def _outcome(job: StoredJob) -> str:
    if job.problem is not None:
        return str(job.problem["detail"])
    made = job.result or {}
    named = next((made[key] for key in ("survey_id", "radio_map_id") if key in made), None)
    if named is not None:
        return str(named)
    return " ".join(f"{count} {name.replace('_', ' ')}" for name, count in job.progress.items())
