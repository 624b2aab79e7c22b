"""``pharos replay``: recorded walks posted as phones would, the answers scored against truth."""

import asyncio
import math
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer
from rich.console import Console
from rich.progress import Progress, TaskID

from app.cli.errors import CommandError
from app.cli.phone_client import PhoneClient, SiteFloor
from app.cli.replay_report import Replayed, fixes_table, report_json, scores_table
from app.core.evaluate import Answer, Place, hold_last, recorded_seconds
from app.formats.ingest_body import ingest_body
from app.formats.ms2020 import Trace, fold_of, read_trace, trace_id_of, trace_paths, truth_at

_AT_ONCE_MAX_SPEED, _AT_ONCE_PACED = 4, 64


@dataclass(frozen=True, slots=True)
class _Run:
    """What all walks of one call share; ``speed`` None: as fast as the server answers."""

    phone: PhoneClient
    site_id: str
    floors: Mapping[str, SiteFloor]
    speed: float | None


def replay(  # noqa: PLR0913 - one parameter per option
    traces: Annotated[
        list[Path], typer.Argument(metavar="TRACE...", help="Trace files, or folders of them.")
    ],
    server: Annotated[str, typer.Option(metavar="URL", help="Server to post to.")],
    token: Annotated[
        str, typer.Option(envvar="PHAROS_TOKEN", help="Token of role surveyor or admin.")
    ],
    site: Annotated[
        str | None, typer.Option(metavar="ID", help="Site; default: the server's only one.")
    ] = None,
    speed: Annotated[
        str, typer.Option(metavar="real|FACTOR|max", help="Pace of posting.")
    ] = "real",
    fold: Annotated[
        list[int] | None, typer.Option(min=0, max=3, help="Of folders, only this fold's traces.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print figures as JSON.")] = False,
) -> None:
    """Post recorded walks like phones, second by second, and compare the answers with the truth.

    Only scans, beacons and inertial samples are posted, never the truth.
    """
    paths = list(_chosen(traces, frozenset(fold or range(4))))
    factor = _speed_factor(speed)
    replayed = asyncio.run(_replay_all(paths, PhoneClient(server, token, 64), site, factor))
    if as_json:
        typer.echo(msgspec.json.format(msgspec.json.encode(report_json(replayed))).decode())
        return
    console = Console()
    if len(replayed) == 1:
        console.print(fixes_table(replayed[0]))
    console.print(scores_table(replayed))


def _chosen(given: Iterable[Path], folds: frozenset[int]) -> Iterable[Path]:
    found = False
    for path in given:
        if path.is_file():
            paths = [path]
        elif path.is_dir():
            folders = [path, *sorted(inner for inner in path.iterdir() if inner.is_dir())]
            of_folders = dict.fromkeys(trace for folder in folders for trace in trace_paths(folder))
            paths = [trace for trace in of_folders if fold_of(trace_id_of(trace)) in folds]
        else:
            msg = f"there is no trace or folder {path}"
            raise CommandError(msg, 2)
        found = found or bool(paths)
        yield from paths
    if not found:
        msg = "there is no trace to replay in what was given"
        raise CommandError(msg, 2)


def _speed_factor(text: str) -> float | None:
    if text == "max":
        return None
    try:
        factor = 1.0 if text == "real" else float(text)
    except ValueError:
        factor = math.nan
    if not 0.0 < factor < math.inf:
        msg = f"--speed {text!r} is neither real, max nor a factor like 10"
        raise CommandError(msg, 2)
    return factor


async def _replay_all(
    paths: list[Path], phone: PhoneClient, site: str | None, speed: float | None
) -> list[Replayed]:
    gate = asyncio.Semaphore(_AT_ONCE_MAX_SPEED if speed is None else _AT_ONCE_PACED)
    with Progress(console=Console(stderr=True), transient=True) as progress:
        async with phone:
            site_id = site or await phone.only_site()
            floors = {floor.name: floor for floor in await phone.floors(site_id)}
            run = _Run(phone, site_id, floors, speed)
            shown = progress.add_task("Replaying", total=len(paths))
            try:
                async with asyncio.TaskGroup() as group:
                    tasks = [
                        group.create_task(_one_at_a_gate(gate, run, path, (progress, shown)))
                        for path in paths
                    ]
            except* CommandError as errors:
                raise errors.exceptions[0] from None
    return [task.result() for task in tasks]


async def _one_at_a_gate(
    gate: asyncio.Semaphore, run: _Run, path: Path, shown: tuple[Progress, TaskID]
) -> Replayed:
    async with gate:
        try:
            trace = await asyncio.to_thread(read_trace, path)
        except (ValueError, OSError) as error:
            msg = f"{path}: {error}"
            raise CommandError(msg) from error
        replayed = await _replay_walk(run, trace)
        progress, task = shown
        progress.advance(task)
        return replayed


async def _replay_walk(run: _Run, trace: Trace) -> Replayed:
    """Post a walk in batches of whole event seconds, each when it is over."""
    floor = _floor_of(run, trace)
    header = {
        "device": {"id": f"replay-{trace.trace_id}", "platform": "android", "app": "pharos replay"},
        "session": uuid.uuid4().hex,
        "site": run.site_id,
        "clock": {"mode": "recorded"},
    }
    begin_s = asyncio.get_running_loop().time()
    truth: list[tuple[float, Place]] = []
    answers: list[Answer | None] = []
    rejected = 0
    # Seconds are numbered like sequence numbers, gaps and all.
    for seq, second in enumerate(recorded_seconds(trace.observations)):
        await _keep_pace(run.speed, begin_s, seq + 1)
        reply = {}
        if second.observations:
            reply = await run.phone.post_batch(ingest_body(header, seq, second.observations))
        place = _truth_place(trace, floor, second.end_s)
        if place is not None and second.is_scored:
            truth.append((second.end_s, place))
            answers.append(_answer(reply))
        rejected += len(reply.get("rejected", ()))
    return Replayed(trace.trace_id, tuple(hold_last(truth, answers)), rejected)


def _floor_of(run: _Run, trace: Trace) -> SiteFloor:
    if trace.floor_name not in run.floors:
        names = ", ".join(run.floors) or "none"
        msg = f"site {run.site_id} has no floor {trace.floor_name!r}; it has: {names}"
        raise CommandError(msg)
    return run.floors[trace.floor_name]


async def _keep_pace(speed: float | None, begin_s: float, seconds: int) -> None:
    if speed is not None:
        due_s = begin_s + seconds / speed
        await asyncio.sleep(max(0.0, due_s - asyncio.get_running_loop().time()))


def _truth_place(trace: Trace, floor: SiteFloor, time_s: float) -> Place | None:
    xy_m = truth_at(trace.waypoints, time_s)
    if xy_m is None:
        return None
    return Place(floor.floor_id, xy_m[0] + floor.x0_m, xy_m[1] + floor.y0_m)


def _answer(reply: Mapping[str, Any]) -> Answer | None:
    fix = reply.get("fix")
    return None if fix is None else Answer(fix["floor_id"], fix["x"], fix["y"], fix["radius95_m"])
