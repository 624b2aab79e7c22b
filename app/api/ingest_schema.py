"""The ingest body as it comes over the wire: types, units and ranges; unknown fields are let pass.

These structs are the only description of the body: they decode it, and OpenAPI is made from them.
Ranges are wide enough for every phone and narrow enough to catch a wrong unit.
"""

from typing import Annotated, Literal, TypeAlias

from msgspec import UNSET, Meta, Raw, Struct, UnsetType, field

MAX_RECORDS = 5000
MAX_SAMPLES = 2000
MAX_READINGS = 1000

# Python's $ matches before a last line break too, which the look-ahead forbids.
Name: TypeAlias = Annotated[str, Meta(min_length=1, max_length=64, pattern=r"^[\x21-\x7e]+$(?!\n)")]
PhoneName: TypeAlias = Annotated[
    str, Meta(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9._:@+-]*$(?!\n)")
]
ShortText: TypeAlias = Annotated[str, Meta(max_length=100)]
ClockMs: TypeAlias = Annotated[
    float,
    Meta(ge=0, le=1e14, description="Milliseconds: since 1970 if wall clock, else since boot."),
]
AgeMs: TypeAlias = Annotated[
    float, Meta(ge=0, le=1e9, description="How long before the record's time it was measured.")
]
LevelDbm: TypeAlias = Annotated[
    float,
    Meta(description="Received level, dBm. 0 (iOS), >= 20 and <= -127 mean: no level, left out."),
]
HeadingDeg: TypeAlias = Annotated[
    float, Meta(ge=-360, le=360, description="Degrees clockwise from north.")
]
Xyz: TypeAlias = tuple[float, float, float]
Wxyz: TypeAlias = tuple[float, float, float, float]
Samples: TypeAlias = Annotated[list[Xyz], Meta(max_length=MAX_SAMPLES)]
Rotations: TypeAlias = Annotated[list[Wxyz], Meta(max_length=MAX_SAMPLES)]
Count: TypeAlias = Annotated[int, Meta(ge=0, le=10_000)]


class AccessPoint(Struct):
    """One Wi-Fi access point heard."""

    bssid: Annotated[str, Meta(max_length=32, description="MAC, any case and separators.")]
    rssi: LevelDbm
    age_ms: AgeMs = 0.0
    freq: Annotated[float, Meta(ge=2000, le=8000, description="MHz")] | None = None
    ssid: ShortText | None = None


class IBeacon(Struct):
    """Identity in an iBeacon frame."""

    uuid: Annotated[str, Meta(max_length=40)]
    major: Annotated[int, Meta(ge=0, le=65535)]
    minor: Annotated[int, Meta(ge=0, le=65535)]


class Eddystone(Struct):
    """Identity in an Eddystone-UID frame, hexadecimal: 10 and 6 bytes."""

    namespace: Annotated[str, Meta(max_length=32)]
    instance: Annotated[str, Meta(max_length=32)]


class AltBeacon(Struct):
    """Identity in an AltBeacon frame, hexadecimal: 20 bytes."""

    id: Annotated[str, Meta(max_length=64)]


class Telemetry(Struct):
    """What a beacon tells of itself; it changes no position."""

    battery_percent: Annotated[float, Meta(ge=0, le=100)] | None = None
    battery_mv: Annotated[float, Meta(ge=0, le=60_000, description="0: not told.")] | None = None
    temperature_c: Annotated[float, Meta(ge=-128, le=128, description="-128: not told.")] | None = (
        None
    )


class HeardBeacon(Struct):
    """One BLE transmitter heard; at least one identity is needed."""

    rssi: LevelDbm
    ibeacon: IBeacon | None = None
    eddystone: Eddystone | None = None
    altbeacon: AltBeacon | None = None
    mac: Annotated[str, Meta(max_length=32)] | None = None
    age_ms: AgeMs = 0.0
    tx1m: Annotated[float, Meta(ge=-127, le=127, description="Advertised level at 1 m.")] | None = (
        None
    )
    n: Count | None = None
    # Unset, they are not in a batch's digest: a retry to a server that knows no telemetry yet, or
    # knew none when the batch came first, is still the same batch.
    telemetry: Telemetry | UnsetType | None = UNSET
    tlm: (
        Annotated[
            str,
            Meta(max_length=64, description="Eddystone-TLM frame (service contents), hexadecimal."),
        ]
        | UnsetType
        | None
    ) = UNSET


class Timed(Struct):
    """A record of one instant: wall clock or, preferred, monotonic clock; one of them is needed."""

    t_ms: ClockMs | None = None
    mono_ms: ClockMs | None = None


class WifiRecord(Timed, tag_field="k", tag="wifi", kw_only=True):
    """One result of the phone's Wi-Fi scanner."""

    aps: Annotated[list[AccessPoint], Meta(max_length=MAX_READINGS)]


class BleRecord(Timed, tag_field="k", tag="ble", kw_only=True):
    """Beacons heard since the last such record."""

    beacons: Annotated[list[HeardBeacon], Meta(max_length=MAX_READINGS)]


class StepRecord(Timed, tag_field="k", tag="step", kw_only=True):
    """Steps told by the phone's step detector."""

    n: Annotated[int, Meta(ge=1, le=100)] = 1
    len_m: Annotated[float, Meta(gt=0, le=3)] | None = None
    heading_deg: HeadingDeg | None = None
    heading_std_deg: Annotated[float, Meta(gt=0, le=180)] | None = None


class PedometerRecord(Struct, tag_field="k", tag="pedometer", kw_only=True):
    """Steps between two instants (iOS)."""

    t0_ms: ClockMs | None = None
    t1_ms: ClockMs | None = None
    mono0_ms: ClockMs | None = None
    mono1_ms: ClockMs | None = None
    steps: Count
    dist_m: Annotated[float, Meta(ge=0, le=20_000)] | None = None
    floors_up: Count | None = None
    floors_down: Count | None = None


class ImuRecord(Struct, tag_field="k", tag="imu", kw_only=True):
    """Evenly spaced inertial samples in Android's axes; the time is that of the first one.

    Lists beside ``acc`` are as long as it, or left out.
    """

    t0_ms: ClockMs | None = None
    mono0_ms: ClockMs | None = None
    mono_ms: ClockMs | None = None
    rate_hz: Annotated[float, Meta(ge=1, le=1000)]
    acc: Annotated[list[Xyz], Meta(min_length=1, max_length=MAX_SAMPLES, description="m/s^2")]
    gyro: Samples = field(default_factory=list)
    mag: Samples = field(default_factory=list)
    quat: Rotations = field(default_factory=list)


class BaroRecord(Timed, tag_field="k", tag="baro", kw_only=True):
    """Air pressure."""

    hpa: Annotated[float, Meta(ge=300, le=1200)]


class TruthRecord(Timed, tag_field="k", tag="truth", kw_only=True):
    """Where a surveyor stands, metres in the site's frame; for roles surveyor and admin."""

    x: Annotated[float, Meta(ge=-1e5, le=1e5)]
    y: Annotated[float, Meta(ge=-1e5, le=1e5)]
    floor_id: Name
    note: Annotated[str, Meta(max_length=500)] = ""


Record: TypeAlias = (
    WifiRecord | BleRecord | StepRecord | PedometerRecord | ImuRecord | BaroRecord | TruthRecord
)

RECORD_TYPES: dict[str, type[Record]] = {
    "wifi": WifiRecord,
    "ble": BleRecord,
    "step": StepRecord,
    "pedometer": PedometerRecord,
    "imu": ImuRecord,
    "baro": BaroRecord,
    "truth": TruthRecord,
}


class Phone(Struct):
    """The phone."""

    id: PhoneName
    platform: Literal["android", "ios", "other"] = "other"
    model: ShortText = ""
    app: ShortText = ""


class PhoneClock(Struct):
    """The phone's clocks at sending; the lowest seq that tells both counts for its session."""

    sent_ms: ClockMs | None = None
    mono_ms: ClockMs | None = None
    boot_id: Name | None = None
    mode: Annotated[
        Literal["live", "recorded"],
        Meta(description="recorded: keep recorded times, no age limits; surveyor and admin only."),
    ] = "live"


class Batch(Struct):
    """One ingest batch; immutable under (device, session, seq)."""

    device: Phone
    session: PhoneName
    seq: Annotated[int, Meta(ge=0, le=2**53 - 1)]
    records: Annotated[list[Raw], Meta(max_length=MAX_RECORDS)]
    clock: PhoneClock = field(default_factory=PhoneClock)
    site: Name | None = None
    profile: Name | None = None


class LocateBody(Struct):
    """A one-shot question: where was this heard."""

    records: Annotated[list[Raw], Meta(min_length=1, max_length=200)]
    site: Name | None = None
    profile: Name | None = None
