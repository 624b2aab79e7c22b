"""Taking a phone's batch: who may post it, for which device and site, and what went wrong."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from app.core.session import LogUnavailableError, Rejection, Untimed
from app.core.types import BleScan, Observation, WifiScan
from app.services.access import Principal, Role
from app.services.beacon_health import BeaconWatch, Heard
from app.services.errors import AppError, ErrorCode, invalid_field, unavailable
from app.services.site_choice import Sites, choose_params, choose_site
from app.sessions.batch import (
    BatchConflictError,
    ClockChangedError,
    ClockReport,
    IncomingBatch,
    IncomingRecord,
    MailboxFullError,
    SessionOverError,
    Submitted,
    UnknownSiteError,
)
from app.sessions.hub import Hub, Topic
from app.sessions.ports import Clock
from app.sessions.registry import SessionRegistry
from app.storage.database import Database, DatabaseUnavailableError
from app.storage.devices import StoredDevice, get_device
from app.storage.enrolment import Sighting, record_sighting

# What is remembered of a device is read again after this, and its last_seen written: another
# process's edit counts within a minute, and a phone posting every second costs one write a minute.
_REMEMBER_S = 60.0
_MAX_REMEMBERED = 50_000


@dataclass(frozen=True, slots=True)
class Upload:
    """One decoded body, as the edge understood it."""

    device_id: str
    platform: str
    model: str
    session: str
    seq: int
    digest: bytes
    clock: ClockReport
    records: tuple[IncomingRecord, ...]
    rejected: tuple[Rejection, ...] = ()
    ignored: int = 0
    site_id: str | None = None
    profile: str | None = None


@dataclass(frozen=True, slots=True)
class _Remembered:
    """A device as it was last read or written; without a time yet while its batch is served."""

    until_s: float
    device: StoredDevice


class IngestService:
    """Hands uploads to the live sessions."""

    def __init__(
        self,
        registry: SessionRegistry,
        hub: Hub,
        sites: Sites,
        database: Database,
        clock: Clock,
        watch: BeaconWatch,
    ) -> None:
        self._registry = registry
        self._hub = hub
        self._sites = sites
        self._database = database
        self._clock = clock
        self._watch = watch
        self._remembered: dict[str, _Remembered] = {}

    async def submit(self, principal: Principal, upload: Upload) -> tuple[str, Submitted]:
        """Make an upload durable and fold it; return its site and the session's answer.

        Raises
        ------
        AppError
            For every refusal; 429 and 503 say when to come again.
        """
        _check_rights(principal, upload)
        with _refusals(upload):
            device = await self._device(upload.device_id)
            site = choose_site(self._sites, principal, upload.site_id, device.site_id)
            usual = choose_params(self._sites, site.site_id, device.profile)
            named = choose_params(self._sites, site.site_id, upload.profile, usual.profile)
            now_s = self._clock.now_s()
            batch = IncomingBatch(
                device_id=upload.device_id,
                session=upload.session,
                seq=upload.seq,
                digest=upload.digest,
                site_id=site.site_id,
                profile=usual.profile,
                received_s=now_s,
                clock=upload.clock,
                records=_levelled(upload.records, device.level_offset_db),
                rejected=upload.rejected,
                ignored=upload.ignored,
                named_profile=named.profile if upload.profile else None,
            )
            submitted = await self._registry.submit(batch)
            self._note_sighting(upload, device, site.site_id, now_s)
            self._watch.note(site.site_id, _heard(upload, submitted), now_s)
            return site.site_id, submitted

    def forget(self, device_id: str) -> None:
        """Read a device anew for its next batch: an admin has changed it."""
        self._remembered.pop(device_id, None)

    async def _device(self, device_id: str) -> StoredDevice:
        remembered = self._remembered.get(device_id)
        if remembered is not None and self._clock.now_s() < remembered.until_s:
            return remembered.device
        if len(self._remembered) >= _MAX_REMEMBERED:
            self._remembered.clear()
        # Gone again when the device is edited before its batch is served: then it is read again.
        self._remembered[device_id] = _Remembered(-math.inf, StoredDevice(device_id))
        stored = await self._database.read(lambda connection: get_device(connection, device_id))
        return stored or StoredDevice(device_id)

    def _note_sighting(
        self, upload: Upload, device: StoredDevice, site_id: str, now_s: float
    ) -> None:
        remembered = self._remembered.get(upload.device_id)
        if remembered is None or (now_s < remembered.until_s and device.site_id == site_id):
            return
        sighting = Sighting(upload.device_id, site_id, upload.platform, upload.model, now_s)
        self._database.submit(lambda connection: record_sighting(connection, sighting))
        if device.first_seen_s is None:
            content = {"event": "enrolled", "device_id": upload.device_id, "site_id": site_id}
            self._hub.publish_event(Topic.DEVICES, content, site_id, upload.device_id)
        seen = replace(device, site_id=site_id, first_seen_s=device.first_seen_s or now_s)
        self._remembered[upload.device_id] = _Remembered(now_s + _REMEMBER_S, seen)


def _heard(upload: Upload, submitted: Submitted) -> Iterator[Heard]:
    """Yield what the batch made durable, with the telemetry of each record; nothing of a retry."""
    refused = {rejection.index for rejection in submitted.rejected}
    taken = [record for record in upload.records if record.index not in refused]
    if submitted.observations:
        for observation, record in zip(submitted.observations, taken, strict=True):
            if not isinstance(observation, Untimed):
                yield observation, record.telemetry


def _levelled(records: tuple[IncomingRecord, ...], offset_db: float) -> tuple[IncomingRecord, ...]:
    """Take a device's offset off its levels; they are logged like this, so replay needs no offset.

    An edited offset counts from the next batch on. The batch's digest is of what was sent: a retry
    is still known.
    """
    if offset_db == 0.0:
        return records
    return tuple(
        replace(record, observation=_shifted(record.observation, offset_db)) for record in records
    )


def _shifted(observation: Observation, offset_db: float) -> Observation:
    if not isinstance(observation, WifiScan | BleScan):
        return observation
    readings = (
        replace(reading, rssi_dbm=reading.rssi_dbm - offset_db) for reading in observation.readings
    )
    return replace(observation, readings=tuple(readings))


def _check_rights(principal: Principal, upload: Upload) -> None:
    if not principal.covers_device(upload.device_id):
        raise AppError(
            ErrorCode.DEVICE_FORBIDDEN, f"the token is not for device {upload.device_id!r}"
        )
    if upload.clock.recorded and principal.role not in (Role.SURVEYOR, Role.ADMIN):
        raise AppError(ErrorCode.ROLE_FORBIDDEN, "only surveyors and admins post recordings")


@contextmanager
def _refusals(upload: Upload) -> Iterator[None]:
    """Turn what sessions and storage raise into what a client is told."""
    try:
        yield
    except MailboxFullError as error:
        raise AppError(
            ErrorCode.TOO_MANY_REQUESTS,
            "too many batches of this device are waiting",
            retry_after_s=math.ceil(error.retry_after_s),
        ) from error
    except (LogUnavailableError, DatabaseUnavailableError) as error:
        raise unavailable() from error
    except BatchConflictError as error:
        raise AppError(
            ErrorCode.SEQ_CONFLICT, f"seq {upload.seq} was taken by other records"
        ) from error
    except SessionOverError as error:
        raise AppError(
            ErrorCode.SESSION_OVER, "the session ended long ago; open a new session"
        ) from error
    except ClockChangedError as error:
        raise AppError(
            ErrorCode.CLOCK_CHANGED,
            "another boot, clock mode or site than the session was opened with; open a new session",
        ) from error
    except UnknownSiteError as error:
        raise invalid_field(pointer="#/site", detail="there is no such site") from error
