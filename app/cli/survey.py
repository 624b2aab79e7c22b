"""``pharos survey``: bring surveys to a running server, watch them being read, judge them."""

import asyncio
import random
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Annotated, Any

import httpx
import typer
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from app.cli.errors import CommandError
from app.cli.survey_list import list_surveys
from app.cli.survey_report import find_ageing, report

surveying = typer.Typer(no_args_is_help=True, help="Bring surveys to a server, and judge them.")
surveying.command("list")(list_surveys)
surveying.command("report")(report)
surveying.command("ageing")(find_ageing)

_PIECE_BYTES = 1 << 18
_TRIES, _LONGEST_WAIT_S, _ASK_EVERY_S = 10, 15.0, 0.3
_random = random.SystemRandom()


@surveying.command("upload")
def upload(  # noqa: PLR0913 - one parameter per option
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="In any known format; plain, gzip, xz or zip.")
    ],
    site: Annotated[str, typer.Option(metavar="ID", help="Site that was surveyed.")],
    token: Annotated[str, typer.Option(envvar="PHAROS_TOKEN", help="Of a surveyor or an admin.")],
    server: Annotated[str, typer.Option(help="Address of the server.")] = "http://localhost:8000",
    name: Annotated[str, typer.Option(help="What to call it; the file's name if left out.")] = "",
    floor: Annotated[
        str | None, typer.Option(metavar="ID", help="Floor of all of it, whatever it says itself.")
    ] = None,
    resume: Annotated[
        str | None, typer.Option(metavar="JOB", help="Continue an upload that was broken off.")
    ] = None,
) -> None:
    """Upload a survey, continue where a broken connection left off, and show what came of it."""
    wish = {
        "site_id": site,
        "name": name or file.name,
        "total_bytes": _size(file),
        "floor_id": floor,
    }
    try:
        client = httpx.AsyncClient(
            base_url=server.rstrip("/"), headers={"Authorization": f"Bearer {token}"}, timeout=60.0
        )
        job = asyncio.run(_upload(client, file, wish, resume))
    except (httpx.InvalidURL, httpx.UnsupportedProtocol) as error:
        msg = f"--server {server!r} cannot be used: {error}"
        raise CommandError(msg, 2) from error
    except httpx.ConnectError as error:
        msg = f"nobody answers at {server}; is the server running, and is this its --server?"
        raise CommandError(msg) from error
    except httpx.TransportError as error:
        msg = f"the connection to {server} broke: {error}"
        raise CommandError(msg) from error
    _report(job)


def _size(file: Path) -> int:
    if file.is_dir():
        msg = f"{file} is a folder: put its files into one zip and send that"
        raise CommandError(msg, 2)
    try:
        return file.stat().st_size
    except OSError as error:
        msg = f"{file} cannot be read: {error.strerror}"
        raise CommandError(msg) from error


async def _upload(
    client: httpx.AsyncClient, file: Path, wish: dict[str, Any], resume: str | None
) -> dict[str, Any]:
    columns = TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True)) as progress:
        async with client:
            if resume is None:
                begun = await _asked(client, "POST", "/v1/surveys/uploads", json=wish)
                job_id = str(begun["job_id"])
                progress.console.print(f"upload {job_id}", markup=False)
            else:
                job_id = resume
            total = float(wish["total_bytes"])
            await _send(client, file, job_id, (progress, progress.add_task("sending", total=total)))
            return await _watch(
                client, job_id, (progress, progress.add_task("reading", total=total))
            )


async def _send(
    client: httpx.AsyncClient, file: Path, job_id: str, bar: tuple[Progress, TaskID]
) -> None:
    """Send what the server lacks, again and again from where it is, until it has all."""
    failures = 0
    while True:
        try:
            job = await _asked(client, "GET", f"/v1/jobs/{job_id}")
            received = int(job["progress"]["received_bytes"])
            bar[0].update(bar[1], completed=received)
            if job["state"] != "receiving":
                return
            url = f"/v1/surveys/uploads/{job_id}?offset={received}"
            await _asked(client, "PATCH", url, content=_pieces(file, received, bar))
            failures = 0
        except httpx.TransportError as error:
            failures += 1
            if failures >= _TRIES:
                msg = f"the connection breaks again and again ({error}); --resume {job_id} later"
                raise CommandError(msg) from error
            wait_s = min(0.5 * 2.0**failures, _LONGEST_WAIT_S)
            await asyncio.sleep(_random.uniform(0.0, wait_s))


async def _pieces(file: Path, offset: int, bar: tuple[Progress, TaskID]) -> AsyncIterator[bytes]:
    with file.open("rb") as opened:
        opened.seek(offset)
        while piece := opened.read(_PIECE_BYTES):
            yield piece
            bar[0].advance(bar[1], len(piece))


async def _watch(
    client: httpx.AsyncClient, job_id: str, bar: tuple[Progress, TaskID]
) -> dict[str, Any]:
    while True:
        job = await _asked(client, "GET", f"/v1/jobs/{job_id}")
        told = job["progress"]
        words = f"{told.get('traces', 0)} walks, {told.get('fingerprints', 0)} fingerprints"
        bar[0].update(bar[1], completed=told.get("read_bytes", 0), description=words)
        if job["state"] in {"done", "failed"}:
            return job
        await asyncio.sleep(_ASK_EVERY_S)


async def _asked(
    client: httpx.AsyncClient,
    method: str,
    url: str,
    **options: Any,  # noqa: ANN401 - httpx's
) -> dict[str, Any]:
    reply = await client.request(method, url, **options)
    # Another request of ours, cut off on the way, may not have ended at the server yet.
    if reply.status_code == httpx.codes.CONFLICT or reply.status_code in {502, 503, 504}:
        raise httpx.ReadError(reply.text)
    try:
        document: dict[str, Any] = reply.json()
    except ValueError as error:
        msg = f"{client.base_url} does not answer like a Pharos server"
        raise CommandError(msg) from error
    if not reply.is_success:
        wrong = [f"{e['pointer']}: {e['detail']}" for e in document.get("errors", ())]
        detail = "; ".join([document.get("detail", ""), *wrong])
        msg = f"the server refuses: {reply.status_code} {detail}"
        raise CommandError(msg)
    return document


def _report(job: dict[str, Any]) -> None:
    outcome = job["result"] or job["problem"]
    console = Console(stderr=True)
    for unusable in outcome.get("unusable", {}).get("first", ()):
        detail = f" ({unusable['detail']})" if unusable["detail"] else ""
        console.print(f"{unusable['place']}: {unusable['reason']}{detail}", markup=False)
    for reason, count in outcome.get("unusable", {}).get("counts", {}).items():
        console.print(f"{count} not used: {reason}", style="yellow", markup=False)
    if job["state"] == "failed":
        msg = f"nothing was stored: {outcome['detail']}"
        raise CommandError(msg)
    told = job["progress"]
    console.print(
        f"survey {outcome['survey_id']} ({outcome['format']}): {told['traces']} walks, "
        f"{told['fingerprints']} fingerprints",
        markup=False,
    )
    typer.echo(outcome["survey_id"])
