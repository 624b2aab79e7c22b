"""Where labelled levels come from: a list, a session with truth, a stored survey, a trace."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from sqlalchemy import Connection

from app.core.fingerprint.survey import chosen_keys
from app.core.survey import Scan, Surveyed, SurveyPoint, SurveyWalk
from app.core.types import BleScan, FloatArray, Observation, Truth, WifiScan
from app.formats.ms2020 import Trace
from app.services.errors import AppError, ErrorCode, found, invalid_field
from app.services.labelled_epochs import (
    LabelledEpoch,
    NameOf,
    by_registered_key,
    local_means,
    survey_epochs,
)
from app.storage import surveys
from app.storage.beacons import StoredBeacon
from app.storage.database import Database
from app.storage.floors import StoredFloor
from app.storage.log import SqlObservationLog, find_session, logged_bytes

MAX_SESSION_BYTES = 64 << 20
"""A day of scans; without inertial data, which goes after a day, a week of them."""


@dataclass(frozen=True, slots=True)
class LabelledLevel:
    """One level heard at a known place, of a beacon by its id or by one of its keys."""

    x_m: float
    y_m: float
    rssi_dbm: float
    beacon_id: str = ""
    key: str = ""
    device_id: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Labelled:
    """Labelled records of one source, before beacons are named.

    Attributes
    ----------
    described
        The source, as JSON: what an admin sees of it later.
    records
        Walks and points.
    levels
        Of a plain list.
    """

    described: Mapping[str, Any]
    device_id: str = ""
    records: tuple[Surveyed, ...] = ()
    levels: tuple[LabelledLevel, ...] = ()

    def epochs(self, floor_id: str, names: "Names") -> list[LabelledEpoch]:
        """Return what was heard at known places on a floor, by beacon id."""
        walked = survey_epochs(self.records, floor_id, self.device_id, names.of_keys)
        return [*walked, *_listed_epochs(self.levels, names)]


@dataclass(frozen=True, slots=True, eq=False)
class Names:
    """Which beacon a reading is of.

    Attributes
    ----------
    of_keys
        By the keys of a reading.
    beacon_ids
        Whom levels may name.
    keys
        Per beacon id, its keys as heard; for those that are not registered yet.
    """

    of_keys: NameOf
    beacon_ids: frozenset[str]
    keys: dict[str, tuple[str, ...]] = field(default_factory=dict)


def registered_names(beacons: Iterable[StoredBeacon]) -> Names:
    """Return the names of registered beacons."""
    known = list(beacons)
    by_key = {key: beacon.beacon_id for beacon in known for key in beacon.keys}
    return Names(by_registered_key(by_key), frozenset(beacon.beacon_id for beacon in known))


def names_of_strangers(labelled: Labelled, beacons: Iterable[StoredBeacon]) -> Names:
    """Return the names of the BLE transmitters of a source that are not registered.

    Their id is made of the key that names them: the beacon identity, unless several addresses
    share it (a vendor's default), then the address.
    """
    taken = {key for beacon in beacons for key in beacon.keys}
    walked = [record for record in labelled.records if isinstance(record, SurveyWalk)]
    scans = [scan for walk in walked for scan in walk.scans if isinstance(scan, BleScan)]
    choose = chosen_keys(scans)
    keys: dict[str, tuple[str, ...]] = {}
    by_keys: dict[tuple[str, ...], str] = {}
    for scan in scans:
        for reading in scan.readings:
            if not taken.intersection(reading.keys):
                key = choose(reading.keys)
                by_keys[reading.keys] = stranger_id(key)
                keys[stranger_id(key)] = (key,)
    for key in _lone_keys(labelled) - taken:
        by_keys[(key,)] = stranger_id(key)
        keys[stranger_id(key)] = (key,)
    return Names(by_keys.get, frozenset(keys), keys)


def _lone_keys(labelled: Labelled) -> set[str]:
    """Return the keys that surveyed points and lists name beacons by, one for each."""
    listed_keys = {level.key for level in labelled.levels if level.key}
    points = [record for record in labelled.records if isinstance(record, SurveyPoint)]
    return listed_keys.union(*(point.ble_dbm for point in points))


def stranger_id(key: str) -> str:
    """Return the id of a beacon that nobody has named: its key, as ids may be spelt."""
    kind, _, rest = key.partition(":")
    if kind != "ibeacon":
        return f"{kind}-{rest.replace(':', '-')}"[:64]
    uuid, major, minor = rest.split(":")
    return f"ibeacon-{uuid.replace('-', '')}-{major}-{minor}"[:64]


def listed(levels: Sequence[LabelledLevel]) -> Labelled:
    """Return a list of levels as a source."""
    return Labelled({"levels": len(levels)}, levels=tuple(levels))


def traced(trace: Trace, floor: StoredFloor, device_id: str) -> Labelled:
    """Return a trace with waypoints as a source; its frame is that of the floor's plan."""
    if len(trace.waypoints) < 2:
        raise AppError(ErrorCode.INVALID_FIELD, "the trace has not two waypoints")
    waypoints = trace.waypoints + np.array([0.0, floor.x0_m, floor.y0_m])
    scans = tuple(o for o in trace.observations if isinstance(o, WifiScan | BleScan))
    walk = SurveyWalk(trace.trace_id, floor.floor_id, scans, np.empty((0, 3)), waypoints)
    return Labelled({"trace": trace.trace_id}, device_id, (walk,))


async def of_survey(database: Database, site_id: str, survey_id: str) -> Labelled:
    """Return a stored survey as a source."""

    def statement(connection: Connection) -> Labelled:
        survey = surveys.get_survey(connection, survey_id)
        if survey is None or survey.site_id != site_id:
            detail = f"site {site_id!r} has no survey {survey_id!r}"
            raise invalid_field(pointer="#/survey_id", detail=detail)
        records = tuple(surveys.records_of_survey(connection, survey_id))
        return Labelled({"survey_id": survey_id}, survey.device_id or survey_id, records)

    return await database.read(statement)


async def of_session(
    database: Database, site_id: str, device_id: str, session: str | None
) -> Labelled:
    """Return a session in which a surveyor stated the truth as a source."""

    def statement(connection: Connection) -> tuple[str, str]:
        record = find_session(connection, device_id, session)
        record = found(record, "session", session or f"of {device_id}")
        if record.site_id != site_id:
            detail = f"the session is of site {record.site_id!r}"
            raise invalid_field(pointer="#/session", detail=detail)
        if logged_bytes(connection, record.session_id) > MAX_SESSION_BYTES:
            raise invalid_field(pointer="#/session", detail="the session is too long for it")
        return record.session_id, record.session

    session_id, name = await database.read(statement)
    observations = await SqlObservationLog(database).observations(session_id)
    walks = tuple(truth_walks(name, observations))
    return Labelled({"device_id": device_id, "session": name}, device_id, walks)


def truth_walks(name: str, observations: Sequence[Observation]) -> Iterator[SurveyWalk]:
    """Yield the walks of a session: from one statement of truth to the last on the same floor."""
    run: list[Truth] = []
    scans = tuple(o for o in observations if isinstance(o, WifiScan | BleScan))
    for truth in [o for o in observations if isinstance(o, Truth)]:
        if run and truth.floor_id != run[0].floor_id:
            yield _walk(name, run, scans)
            run = []
        run.append(truth)
    if run:
        yield _walk(name, run, scans)


def _walk(name: str, run: Sequence[Truth], scans: tuple[Scan, ...]) -> SurveyWalk:
    waypoints: FloatArray = np.array([(t.time_s, t.x_m, t.y_m) for t in run])
    return SurveyWalk(name, run[0].floor_id, scans, np.empty((0, 3)), waypoints)


def _listed_epochs(levels: Iterable[LabelledLevel], names: Names) -> Iterator[LabelledEpoch]:
    """Yield one epoch for each phone and place of a list."""
    heard: dict[tuple[str, float, float], list[tuple[str, float]]] = {}
    for level in levels:
        name = _name(level, names)
        if name is not None:
            place = (level.device_id, level.x_m, level.y_m)
            heard.setdefault(place, []).append((name, level.rssi_dbm))
    for (device_id, x_m, y_m), named in heard.items():
        yield LabelledEpoch(device_id, x_m, y_m, local_means(named))


def _name(level: LabelledLevel, names: Names) -> str | None:
    if level.beacon_id:
        return level.beacon_id if level.beacon_id in names.beacon_ids else None
    return names.of_keys((level.key,))
