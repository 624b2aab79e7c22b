"""Surveys as stored: walks whole, points a few hundred to a row, all hidden until complete."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeAlias

from sqlalchemy import Connection, RowMapping, delete, insert, select, tuple_, update

from app.core.survey import Surveyed, SurveyPoint, SurveyWalk
from app.storage.codec import VariantCodec
from app.storage.rows import unique, update_row
from app.storage.survey_tables import SURVEY_RECORDS, SURVEYS

_CODEC: VariantCodec[Surveyed] = VariantCodec({"walk": SurveyWalk, "point": SurveyPoint})

RecordRow: TypeAlias = dict[str, Any]
"""The columns of one stored record, without the survey's id: what a parsing process sends."""

SurveyKey: TypeAlias = tuple[float, str]
"""Where a page of the list ends: when its last survey was stored, and the survey's id."""


@dataclass(frozen=True, slots=True)
class Holding:
    """What a survey holds of one floor.

    ``fingerprints`` are surveyed points; the scans of walks become fingerprints when a map is
    built, by its rules.
    """

    floor_id: str
    walks: int
    scans: int
    fingerprints: int
    transmitters: int
    first_s: float | None = None
    last_s: float | None = None


@dataclass(frozen=True, slots=True)
class StoredSurvey:
    """What is known of a survey without loading its records.

    Attributes
    ----------
    survey_format
        Name of the format it came in, or ``session``.
    unusable
        As JSON: ``counts`` by reason, and ``first`` with the place and words of the first ones.
    """

    survey_id: str
    site_id: str
    name: str
    survey_format: str
    created_s: float
    holdings: tuple[Holding, ...] = ()
    unusable: dict[str, Any] | None = None
    device_id: str | None = None
    device_model: str | None = None
    row_version: int = 1


def walk_row(walk: SurveyWalk) -> RecordRow:
    """Return the row of a walk."""
    first_s, last_s = walk.span_s
    return _row("walk", walk.floor_id, walk.walk, (first_s, last_s), [walk])


def points_row(points: Sequence[SurveyPoint]) -> RecordRow:
    """Return the row of some points, all of one floor and walk."""
    times = [point.time_s for point in points if point.time_s is not None]
    span_s = (min(times), max(times)) if times else (None, None)
    return _row("points", points[0].floor_id, points[0].walk, span_s, points)


def begin_survey(connection: Connection, survey: StoredSurvey) -> None:
    """Add a survey that nobody sees until `complete_survey`."""
    with unique(f"survey {survey.survey_id!r}"):
        connection.execute(
            insert(SURVEYS).values(
                id=survey.survey_id,
                site_id=survey.site_id,
                name=survey.name,
                format=survey.survey_format,
                device_id=survey.device_id,
                device_model=survey.device_model,
                created_s=survey.created_s,
                complete=False,
            )
        )


def add_records(connection: Connection, survey_id: str, rows: Sequence[RecordRow]) -> None:
    """Add records (`walk_row`, `points_row`) to a survey that is not complete yet."""
    connection.execute(insert(SURVEY_RECORDS), [{**row, "survey_id": survey_id} for row in rows])


def complete_survey(connection: Connection, survey: StoredSurvey) -> None:
    """Show a survey whose records are all there, with its format and what it holds."""
    connection.execute(
        update(SURVEYS)
        .where(SURVEYS.c.id == survey.survey_id)
        .values(
            complete=True,
            format=survey.survey_format,
            device_model=survey.device_model,
            holdings=[asdict(holding) for holding in survey.holdings],
            unusable=survey.unusable,
        )
    )


def rename_survey(connection: Connection, survey: StoredSurvey, name: str) -> StoredSurvey:
    """Store another name of a survey read as ``row_version``; StaleError if that is past."""
    values = {"name": name}
    row_version = update_row(connection, SURVEYS, survey.survey_id, survey.row_version, values)
    return replace(survey, name=name, row_version=row_version)


def delete_survey(connection: Connection, survey_id: str) -> bool:
    """Remove a survey with all its records, complete or not; tell whether it was there."""
    return connection.execute(delete(SURVEYS).where(SURVEYS.c.id == survey_id)).rowcount == 1


def delete_incomplete(connection: Connection) -> int:
    """Remove surveys whose import was cut off by the end of the server; return how many."""
    return connection.execute(delete(SURVEYS).where(SURVEYS.c.complete.is_(False))).rowcount


def get_survey(connection: Connection, survey_id: str) -> StoredSurvey | None:
    """Return what is known of a complete survey."""
    query = select(SURVEYS).where(SURVEYS.c.id == survey_id, SURVEYS.c.complete)
    row = connection.execute(query).mappings().one_or_none()
    return None if row is None else _stored(row)


def list_surveys(
    connection: Connection,
    *,
    site_id: str | None = None,
    after: SurveyKey | None = None,
    limit: int,
) -> list[StoredSurvey]:
    """Return up to ``limit + 1`` complete surveys of one site or all, the newest first."""
    newest_first = SURVEYS.c.created_s.desc(), SURVEYS.c.id.desc()
    query = select(SURVEYS).where(SURVEYS.c.complete).order_by(*newest_first).limit(limit + 1)
    if site_id is not None:
        query = query.where(SURVEYS.c.site_id == site_id)
    if after is not None:
        query = query.where(tuple_(SURVEYS.c.created_s, SURVEYS.c.id) < after)
    return [_stored(row) for row in connection.execute(query).mappings()]


def records_of_survey(connection: Connection, survey_id: str) -> Iterator[Surveyed]:
    """Yield the walks and points of a survey in the order they came, a row at a time."""
    records = SURVEY_RECORDS.c
    row_ids = connection.execute(
        select(records.id).where(records.survey_id == survey_id).order_by(records.id)
    ).scalars()
    for row_id in row_ids.all():
        payload = connection.execute(select(records.payload).where(records.id == row_id)).scalar()
        if payload is not None:
            yield from _CODEC.decode(payload)


def _row(
    kind: str,
    floor_id: str,
    walk: str,
    span_s: tuple[float | None, float | None],
    records: Sequence[Surveyed],
) -> RecordRow:
    return {
        "kind": kind,
        "floor_id": floor_id,
        "walk": walk,
        "first_s": span_s[0],
        "last_s": span_s[1],
        "payload": _CODEC.encode(records),
    }


def _stored(row: RowMapping) -> StoredSurvey:
    return StoredSurvey(
        survey_id=row["id"],
        site_id=row["site_id"],
        name=row["name"],
        survey_format=row["format"],
        created_s=row["created_s"],
        holdings=tuple(Holding(**holding) for holding in row["holdings"] or ()),
        unusable=row["unusable"],
        device_id=row["device_id"],
        device_model=row["device_model"],
        row_version=row["row_version"],
    )
