"""The page docs/accuracy.md, made of the figures that `pharos evaluate` wrote."""

import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from app.services.evaluation.figures import Evaluation, Figures

HEAD = """# Accuracy

What was measured, on which data, by which command. This page is made of the commands' own figures
by `pharos evaluate report`; it is not edited by hand. `DIR` is the folder of the data set.

An error is the distance on the plane between an answer and the truth, and says nothing of floors.
A mean is over all seconds or scans, not over walks. None of these figures is a promise for another
building: what it would be there depends on its radio map, beacons and phones.
"""

ABOUT = {
    "ms2020": """Real walks through a shopping mall with one model of phone, Wi-Fi, some beacons and
inertial sensors. The engine is told neither floor, start nor heading, and the traces it is asked
are not in its map. The figures are of one building and one phone; parameters were chosen on its
other traces (their error is `tuning_mean_error_m`), so another building may be worse. The traces
asked were looked at several times meanwhile; after one such look the filter was tuned anew, on the
other traces again.
`floor_accuracy_per_scan` takes each Wi-Fi scan alone. `coverage95` is the share of the truth inside
`radius95_m`, over seconds with a fix of their own, and `by_decile` the same from the smallest tenth
of the radii to the largest. `smoothed` are the tracks as they are stored once a session is over; a
live page does not see them. `no_fix_share` are mostly the seconds between a walk's first beacons
and its first Wi-Fi scan: for 3 s the engine waits for that, since beacons alone would place the
phone 11 m off there and not always on its floor ([best](methods/best.md) says what not waiting
would cost). `lost_share` are the seconds after a walk's first fix that got none of their own. With
`--map-share` the map has only that share of
each floor's surveyed walks. `--phone` posts the same walks as another phone would: `iphone` without
any Wi-Fi scan, `throttled` with one in 30 s, `louder` and `weaker` with 10 dB added to and taken
off all levels, of which the engine is not told.""",
    "uji-ble": """Single scans, and all scans of a point together, among beacons at known places,
one phone, held still: no motion, no filter. The beacons are calibrated in the same room with the
same phone; a phone that was never calibrated is `lateration_10_db_off`. Scans that hear fewer than
three beacons are not asked; how many those are is in the table. How many beacons the weighted
centroid takes, and how it weighs them, was chosen with these scans at hand.""",
    "kolakowski": """A slow robot in a flat of 9 by 7 m with six receivers and walls on all sides;
roles are reversed, the robot transmits. `lateration` and `fingerprint` see two seconds;
`best_path_loss`, `best_radio_map` and the profile `grinyak2018` (path loss, too) are the engine
without any inertial sensor, and `smoothed` its stored track; `grinyak2018` has no smoother.
`lateration` and `best_path_loss` know the plan's walls, `best_path_loss_without_walls` not.""",
    "ujiindoorloc": """Single Wi-Fi scans by many phones in three buildings, months after the
survey: matching alone, no motion, no filter. The matcher runs with the parameters of the profile
`best`. Between two exponents that are as good on ms2020 the one was taken that is better here, with
these scans in view; nothing else was fitted. `median_query_ms` is CPU time on the machine that made
this page.""",
    "oxford-steps": """Six walks of one person, who carries the phone in six ways, some 340 steps
each. Steps are counted, not measured: this says nothing of step length or heading. The low-pass of
the detector was chosen with these recordings at hand.""",
    "papers": """Simulations after the set-ups that the papers behind the profiles describe, with
each paper's own parameters; the papers' recordings are not public. They show that a system is built
as published, by the ratios and orders that its paper reports. They are not figures of any building,
and the metres of two papers are not to be compared. `median`, `p10` and `p90` are over the seeds of
the simulation; `target` is what the paper reports or what was asked of it. `docs/methods` has a
page for each, which also says what could not be reproduced.""",
}


STATISTICS = ("median", "p10", "p90", "target")
"""Columns of the papers' table, as `over_seeds` names them."""


def report_page(evaluations: Iterable[Evaluation]) -> str:
    """Return the page: a section per evaluation, with its command, protocol and figures."""
    sections, explained = [HEAD], set[str]()
    for evaluation in evaluations:
        name = evaluation.dataset.split()[0]
        sections.append(_section(evaluation, explain=name not in explained))
        explained.add(name)
    return "\n".join(sections)


def _section(evaluation: Evaluation, *, explain: bool) -> str:
    table = "\n".join(_table(columns_of(evaluation)))
    if not explain:
        return f"## {evaluation.dataset}\n\n`{evaluation.command}`\n\n{table}\n"
    about = ABOUT[evaluation.dataset.split()[0]]
    protocol = _protocol(evaluation.protocol.splitlines())
    return (
        f"## {evaluation.dataset}\n\n`{evaluation.command}`\n\n{about}\n\n{protocol}\n\n{table}\n"
    )


def _protocol(lines: Sequence[str]) -> str:
    if len(lines) == 1:
        return textwrap.fill(f"Protocol: {lines[0]}.", 100)
    items = (textwrap.fill(f"- {line}.", 100, subsequent_indent="  ") for line in lines)
    return "\n".join(("Protocols:\n", *items))


def columns_of(evaluation: Evaluation) -> Mapping[str, Figures]:
    """Return an evaluation's figures as the columns of its table.

    The papers have no figure in common, so theirs are below each other and a column is a statistic.
    """
    if evaluation.dataset == "papers":
        return {name: _statistic(evaluation.profiles, name) for name in STATISTICS}
    return evaluation.profiles


def _statistic(figures: Figures, name: str) -> dict[str, Any]:
    """Return the part of nested figures that is one statistic, in their own structure.

    A number that does not depend on the seeds is its own median.
    """
    parts: dict[str, Any] = {}
    for key, value in figures.items():
        if not isinstance(value, Mapping):
            parts[key] = value if name == "median" else None
        elif "median" in value:
            parts[key] = value[name]
        else:
            parts[key] = _statistic(value, name)
    return parts


def _table(of: Mapping[str, Figures]) -> Iterator[str]:
    columns = {name: dict(flat(figures)) for name, figures in of.items()}
    yield "| | " + " | ".join(f"`{name}`" for name in columns) + " |"
    yield "|---|" + "---|" * len(columns)
    for row in dict.fromkeys(name for column in columns.values() for name in column):
        cells = " | ".join(column.get(row, "") for column in columns.values())
        yield f"| `{row}` | {cells} |"


def flat(figures: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield each figure's name, dotted where it is of a group, and how it is written."""
    for name, value in figures.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{name}.")
        elif isinstance(value, tuple | list):
            yield f"{prefix}{name}", " ".join(_written("", each) for each in value).strip()
        else:
            yield f"{prefix}{name}", _written(prefix + name, value)


def _written(name: str, value: float | None) -> str:
    if value is None or math.isnan(value):
        return ""
    if isinstance(value, int):
        return f"{value}"
    if any(word in name for word in ("share", "accuracy", "coverage")):
        return f"{100.0 * value:.1f} %"
    return f"{value:.2f}" if abs(value) < 100.0 else f"{value:.0f}"
