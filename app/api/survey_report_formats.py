"""A survey report as JSON and as a page to be printed."""

import base64
import math
from html import escape
from typing import Any

from app.api.fix import iso_time
from app.core.fingerprint.quality import LeftOut
from app.core.fingerprint.survey_report import Cells, Conflict, ThinSpot
from app.services.survey_reports import JudgedBy, Reported, ReportedMap, ReportedSurvey

DAY_S = 86_400.0

_STYLE = """body{font:14px/1.4 sans-serif;max-width:60em;margin:2em auto;color:#111}
table{border-collapse:collapse;margin:1em 0}td,th{border:1px solid #999;padding:.2em .6em;
text-align:right}img{max-width:100%}h2{page-break-before:auto}"""


_JUDGED = {
    JudgedBy.OTHER_WALKS: "Each scan was matched with the other walks of the survey.",
    JudgedBy.ACTIVE_RADIO_MAP: "It has one walk: its scans were matched with the active radio map.",
    JudgedBy.NOTHING: "It has one walk, and nothing else can judge it: no error is known.",
}


def report_json(told: ReportedMap, now_s: float) -> dict[str, Any]:
    """Return the report; lengths in metres, shares 0 to 1, places in the site's frame."""
    radio_map = told.radio_map
    return {
        "radio_map_id": radio_map.radio_map_id,
        "site_id": radio_map.site_id,
        "version": radio_map.version,
        **_created(radio_map.created_s, now_s),
        **_findings(told.reported),
    }


def survey_report_json(told: ReportedSurvey, now_s: float) -> dict[str, Any]:
    """Return the report of a survey in the same form; ``judged_by`` is a `JudgedBy`."""
    survey = told.survey
    return {
        "survey_id": survey.survey_id,
        "site_id": survey.site_id,
        "name": survey.name,
        "judged_by": told.judged_by.value,
        "radio_map_id": None if told.radio_map is None else told.radio_map.radio_map_id,
        **_created(survey.created_s, now_s),
        **_findings(told.reported),
    }


def _created(created_s: float, now_s: float) -> dict[str, Any]:
    age_days = round((now_s - created_s) / DAY_S, 2)
    return {"created": iso_time(created_s), "age_days": age_days}


def _findings(reported: Reported) -> dict[str, Any]:
    report, ids = reported.report, [floor.floor_id for floor in reported.floors]
    return {
        "floors": [
            {
                "floor_id": ids[f.floor_index],
                "walks": f.walks,
                "scans": f.scans,
                "transmitters_per_scan": _rounded(f.transmitters_per_scan),
                "median_error_m": _rounded(f.median_error_m),
                "p95_error_m": _rounded(f.p95_error_m),
                "wrong_floor_share": _rounded(f.wrong_floor_share, 4),
            }
            for f in report.floors
        ],
        "thin_spots": [_spot(spot, ids) for spot in report.thin_spots],
        "conflicts": [_conflict(conflict, ids) for conflict in report.conflicts],
        "wrong_floors": [_conflict(conflict, ids) for conflict in report.wrong_floors],
        "cells": _cells(report.cells, ids),
        "scans": _scans(report.left_out, ids),
    }


def _cells(cells: Cells, ids: list[str]) -> dict[str, Any]:
    return {
        "floor_id": [ids[i] for i in cells.floor_index.tolist()],
        "x_m": [_rounded(v) for v in cells.x_m.tolist()],
        "y_m": [_rounded(v) for v in cells.y_m.tolist()],
        "predicted_error_m": [_rounded(v) for v in cells.predicted_error_m.tolist()],
        "nearest_scan_m": [_rounded(v) for v in cells.nearest_scan_m.tolist()],
    }


def _scans(left_out: LeftOut, ids: list[str]) -> dict[str, Any]:
    return {
        "floor_id": [ids[i] for i in left_out.floor_index.tolist()],
        "x_m": [_rounded(v) for v in left_out.x_m.tolist()],
        "y_m": [_rounded(v) for v in left_out.y_m.tolist()],
        "error_m": [_rounded(v) for v in left_out.error_m.tolist()],
        "transmitters": left_out.transmitters.tolist(),
    }


def _rounded(value: float | None, digits: int = 2) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, digits)


def _spot(spot: ThinSpot, ids: list[str]) -> dict[str, Any]:
    return {
        "floor_id": ids[spot.floor_index],
        "x_m": _rounded(spot.x_m),
        "y_m": _rounded(spot.y_m),
        "predicted_error_m": _rounded(spot.predicted_error_m),
        "nearest_scan_m": _rounded(spot.nearest_scan_m),
        "cost_share": _rounded(spot.cost_share, 4),
    }


def _conflict(conflict: Conflict, ids: list[str]) -> dict[str, Any]:
    return {
        "floor_id": ids[conflict.floor_index],
        "x_m": _rounded(conflict.x_m),
        "y_m": _rounded(conflict.y_m),
        "like_floor_id": ids[conflict.like_floor_index],
        "like_x_m": _rounded(conflict.like_x_m),
        "like_y_m": _rounded(conflict.like_y_m),
        "scans": conflict.scans,
        "share": _rounded(conflict.share, 4),
    }


def report_html(document: dict[str, Any], pictures: dict[str, bytes]) -> bytes:
    """Return the report as one page without scripts or links, to be printed.

    Parameters
    ----------
    document
        What `report_json` or `survey_report_json` returns.
    pictures
        A PNG by floor id.
    """
    title, about = _headings(document)
    meaning = "Errors are of single scans matched alone, in metres; tracks are better than those."
    parts = [
        f"<h1>{escape(title)}</h1>",
        f"<p>{escape(about)} {meaning}</p>",
        _table("Floors", document["floors"]),
        _table("Thin spots: survey these first", document["thin_spots"]),
        _table("Conflicts: far apart, look alike", document["conflicts"]),
        _table("Wrong floors", document["wrong_floors"]),
    ]
    for floor_id, png in pictures.items():
        source = base64.b64encode(png).decode()
        parts.append(
            f"<h2>{escape(floor_id)}</h2><img alt='' src='data:image/png;base64,{source}'>"
        )
    page = (
        f"<!doctype html><html lang='en'><head><meta charset='utf-8'><title>{escape(title)}</title>"
        f"<style>{_STYLE}</style></head><body>{''.join(parts)}</body></html>"
    )
    return page.encode()


def _headings(document: dict[str, Any]) -> tuple[str, str]:
    site_id, age = (
        document["site_id"],
        f"{document['created']}, {document['age_days']:.0f} days ago",
    )
    if "survey_id" in document:
        judged = _JUDGED[JudgedBy(document["judged_by"])]
        named = document["name"] or document["survey_id"]
        return f"Survey report: {site_id}, survey {named}", f"Stored {age}. {judged}"
    return f"Survey report: {site_id}, radio map version {document['version']}", f"Built {age}."


def _table(title: str, rows: list[dict[str, Any]]) -> str:
    if not rows:
        return f"<h2>{escape(title)}</h2><p>None.</p>"
    head = "".join(f"<th>{escape(name)}</th>" for name in rows[0])
    body = "".join(
        "<tr>" + "".join(f"<td>{_cell(value)}</td>" for value in row.values()) + "</tr>"
        for row in rows
    )
    return f"<h2>{escape(title)}</h2><table><tr>{head}</tr>{body}</table>"


def _cell(value: object) -> str:
    return "" if value is None else escape(str(value))
