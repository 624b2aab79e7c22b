"""Small surveys of one hall, one in each format, and the hall's frame."""

import json

from app.core.georeference import ControlPoint, fit_georeference
from app.core.site import Floor
from app.formats.survey_places import SurveyFrame

LAT, LON = 50.0, 10.0
GEOREFERENCE = fit_georeference(
    [
        ControlPoint(0.0, 0.0, LAT, LON),
        ControlPoint(20.0, 0.0, LAT, LON + 20.0 / 71_696.0),
        ControlPoint(0.0, 10.0, LAT + 10.0 / 111_229.0, LON),
    ]
)
FRAME = SurveyFrame(
    (
        Floor("hall-0", "F1", "A", 0, 0.0, 0.0, 20.0, 10.0),
        Floor("hall-1", "F2", "A", 1, 100.0, 0.0, 20.0, 10.0),
    ),
    GEOREFERENCE,
)
T0_MS = 1_700_000_000_000
MACS = ("aa:bb:cc:dd:ee:01", "aa:bb:cc:dd:ee:02", "aa:bb:cc:dd:ee:03")


def ms2020_trace(floor: str = "F1", seconds: int = 20, start_ms: int = T0_MS) -> str:
    """Return a walk along y = 5 m at 0.5 m/s with a scan every two seconds, steps at 2 Hz."""
    lines = [
        f"#\tstartTime:{start_ms}",
        f"#\tSiteID:x\tSiteName:Hall\tFloorId:y\tFloorName:{floor}",
        "#\tBrand:OPPO\tModel:PBCM10\tAndroidName:8.1.0\tAPILevel:27\t",
    ]
    for ms in range(0, seconds * 1000 + 1, 20):
        t = start_ms + ms
        swing = 3.0 * (1 if (ms // 250) % 2 else -1)
        lines.append(f"{t}\tTYPE_ACCELEROMETER\t0\t0\t{9.81 + swing}\t3")
        lines.append(f"{t}\tTYPE_ROTATION_VECTOR\t0\t0\t0\t3")
        if ms % 2000 == 0:
            lines += [
                f"{t}\tTYPE_WIFI\tnet\t{mac}\t{-50 - i}\t2412\t{t - 100}"
                for i, mac in enumerate(MACS)
            ]
        if ms % 10_000 == 0:
            lines.append(f"{t}\tTYPE_WAYPOINT\t{1.0 + ms / 2000.0}\t5.0")
    return "\n".join([*lines, f"#\tendTime:{start_ms + seconds * 1000}"]) + "\n"


LONG_CSV = (
    "point,floor_id,x,y,kind,key,rssi_dbm,walk\n"
    "P1,hall-0,1,2,wifi,mac:aabbccddee01,-50,w\n"
    "P1,hall-0,1,2,wifi,mac:aabbccddee01,-52,w\n"
    "P1,hall-0,1,2,ble,mac:aabbccddee02,-70,w\n"
    "P2,hall-0,3,2,wifi,mac:aabbccddee01,-60,w\n"
)
WIDE_CSV = (
    "WAP001,WAP002,WAP003,X,Y,FLOOR,BUILDINGID,PHONEID,TIMESTAMP\n"
    "-50,100,-70,1,2,0,A,7,1371713733\n"
    "100,-60,100,3,2,0,A,7,1371713734\n"
)


def points_json(**changed: object) -> str:
    """Return our JSON with one good point and one that is changed."""
    good = {
        "point": "P1",
        "floor_id": "hall-0",
        "x": 1.0,
        "y": 2.0,
        "time_s": 1.7e9,
        "readings": [{"kind": "wifi", "key": "mac:aabbccddee01", "rssi_dbm": -50.0}],
    }
    return json.dumps({"points": [good, {**good, **changed}]})


def place(x_m: float, y_m: float) -> tuple[float, float]:
    """Return latitude and longitude of a place of the hall."""
    return GEOREFERENCE.to_wgs84(x_m, y_m)


def geosubmit() -> str:
    """Return two submissions; the second heard nothing."""
    lat, lon = place(4.0, 3.0)
    position = {"latitude": lat, "longitude": lon, "accuracy": 5.0}
    heard = [{"macAddress": mac, "signalStrength": -60} for mac in MACS]
    return json.dumps(
        {
            "items": [
                {"timestamp": T0_MS, "position": position, "wifiAccessPoints": heard},
                {"timestamp": T0_MS, "position": position, "cellTowers": []},
            ]
        }
    )


def getsensordata() -> str:
    """Return a log of ten seconds with two places, and one that was never filled in."""
    lines = ["% LogFile created by the GetSensorData app", "% Phone: X"]
    for i in range(11):
        lines.append(f"WIFI;{i}.0;{i}.0;a;b;c;{MACS[0]};2412;-5{i % 10}")
        lines.append(f"BLE4;{i}.2;iBeacon;{MACS[1]};-70;-59;1;2;{'0' * 32}")
    for i, (x, y) in enumerate([(1.0, 5.0), (6.0, 5.0)]):
        lat, lon = place(x, y)
        lines.append(f"POSI;{i * 10}.0;{i};{lat:.9f};{lon:.9f};0;A")
    lines.append("POSI;10.0;2;0;0;0;0")
    return "\n".join(lines) + "\n"


def anyplace() -> str:
    """Return two scans at two places, and a row that is none."""
    rows = ["# Timestamp, X, Y, HEADING, MAC Address of AP, RSS, FLOOR"]
    for x in (2.0, 6.0):
        lat, lon = place(x, 3.0)
        rows += [f"{T0_MS + int(x)} {lat:.9f} {lon:.9f} 90.0 {mac} -61 0" for mac in MACS]
    return "\n".join([*rows, "nonsense"]) + "\n"
