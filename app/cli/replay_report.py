"""The figures of a replay, as tables and as JSON."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rich.table import Table

from app.core.evaluate import Score, ScoredSecond, score


@dataclass(frozen=True, slots=True)
class Replayed:
    """One walk as the server answered it.

    ``rejected`` counts the records that the server did not take.
    """

    trace_id: str
    seconds: tuple[ScoredSecond, ...]
    rejected: int


def report_json(walks: Sequence[Replayed]) -> dict[str, Any]:
    """Return figures per trace and pooled over all their seconds; absent ones are null."""
    traces = [
        {"trace_id": walk.trace_id, **_figures(score(walk.seconds)), "rejected": walk.rejected}
        for walk in walks
    ]
    return {"traces": traces, "pooled": _figures(_pooled(walks))}


def scores_table(walks: Sequence[Replayed]) -> Table:
    """Return a row of figures per trace, and one for all of them."""
    table = Table(title="Error at 1 Hz, from the first scan on")
    table.add_column("trace", no_wrap=True)
    for heading in ("mean m", "median m", "p95 m", "floor right", "samples", "no fix"):
        table.add_column(heading, justify="right")
    for walk in walks:
        table.add_row(walk.trace_id, *_cells(score(walk.seconds)))
    table.add_section()
    table.add_row(f"all {len(walks)}", *_cells(_pooled(walks)), style="bold")
    return table


def fixes_table(walk: Replayed) -> Table:
    """Return the answers of one walk beside the truth, by the seconds since its first one."""
    table = Table(title=walk.trace_id)
    for heading in ("s", "true x", "true y", "true floor", "x", "y", "floor", "error m"):
        table.add_column(heading, justify="right", no_wrap=True)
    for second in walk.seconds:
        since_s = second.time_s - walk.seconds[0].time_s
        place = (f"{second.truth.x_m:.1f}", f"{second.truth.y_m:.1f}", second.truth.floor_id)
        table.add_row(f"{since_s:.0f}", *place, *_answer_cells(second))
    return table


def _pooled(walks: Sequence[Replayed]) -> Score:
    return score(second for walk in walks for second in walk.seconds)


def _figures(scored: Score) -> dict[str, float | int]:
    return {
        "mean_error_m": scored.mean_error_m,
        "median_error_m": scored.median_error_m,
        "p95_error_m": scored.p95_error_m,
        "floor_accuracy": scored.floor_right_share,
        "samples": scored.samples,
        "no_fix": scored.no_fix,
        "no_fix_share": scored.no_fix_share,
    }


def _cells(scored: Score) -> tuple[str, ...]:
    return (
        f"{scored.mean_error_m:.2f}",
        f"{scored.median_error_m:.2f}",
        f"{scored.p95_error_m:.2f}",
        f"{100 * scored.floor_right_share:.1f} %",
        f"{scored.samples}",
        f"{100 * scored.no_fix_share:.1f} %",
    )


def _answer_cells(second: ScoredSecond) -> tuple[str, str, str, str]:
    answer, error_m = second.answer, second.error_m
    if answer is None or error_m is None:
        return ("no fix", "", "", "")
    held = " (held)" if second.no_fix else ""
    return (f"{answer.x_m:.1f}", f"{answer.y_m:.1f}", answer.floor_id, f"{error_m:.1f}{held}")
