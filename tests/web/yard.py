"""A small site with beacons, and phones that walk its two floors in real time, over HTTP."""

import io
import threading
import uuid
from typing import Self

import httpx
import numpy as np
from PIL import Image, ImageDraw

from app.core.types import BleScan, Reading
from app.formats.ingest_body import ingest_body
from app.main import SystemClock

SITE_ID = "yard"
WIDTH_M, HEIGHT_M = 30.0, 20.0
FLOORS = {"yard-ground": "Ground", "yard-upper": "Upper"}
BEACONS = {
    f"{floor_id}-{i}": (floor_id, f"a4c1380{level}000{i}", x_m, y_m)
    for level, floor_id in enumerate(FLOORS)
    for i, (x_m, y_m) in enumerate([(3, 3), (15, 3), (27, 3), (3, 17), (15, 17), (27, 17)])
}
# Who walks where: two below, one above.
WALKERS = {"walker-1": "yard-ground", "walker-2": "yard-ground", "walker-3": "yard-upper"}
PERIOD_S = 0.4
WALKING_MPS = 1.4


def build_yard(client: httpx.Client) -> None:
    """Make the site through the API."""
    _post(client, "/v1/sites", {"site_id": SITE_ID, "name": "Yard"})
    for ordinal, (floor_id, name) in enumerate(FLOORS.items()):
        frame = {"ordinal": ordinal, "width": WIDTH_M, "height": HEIGHT_M}
        floor = {"site_id": SITE_ID, "floor_id": floor_id, "name": name, **frame}
        _post(client, "/v1/floors", floor)
        headers = {"Content-Type": "image/png"}
        plan = client.put(f"/v1/floors/{floor_id}/plan", content=_plan_png(), headers=headers)
        plan.raise_for_status()
    for beacon_id, (floor_id, mac, x_m, y_m) in BEACONS.items():
        place = {"floor_id": floor_id, "x": x_m, "y": y_m, "z": 2.5}
        keys = {"kind": "ble", "keys": [f"mac:{mac}"], "shadowing_db": 3.0}
        _post(client, "/v1/beacons", {"site_id": SITE_ID, "beacon_id": beacon_id, **keys, **place})


def _post(client: httpx.Client, path: str, body: dict[str, object]) -> None:
    client.post(path, json=body).raise_for_status()


def _plan_png() -> bytes:
    image = Image.new("RGB", (600, 400), "white")
    ImageDraw.Draw(image).rectangle((250, 150, 350, 250), fill="#c9d0d8")
    out = io.BytesIO()
    image.save(out, "PNG")
    return out.getvalue()


class Walkers:
    """Phones that post a scan every moment until the block ends; lost batches are sent again."""

    def __init__(self, url: str, token: str) -> None:
        self._client = httpx.Client(
            base_url=url, headers={"Authorization": f"Bearer {token}"}, timeout=5.0
        )
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._walk, name="walkers")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._client.close()

    def _walk(self) -> None:
        rng = np.random.default_rng(7)
        clock = SystemClock()
        start_s = clock.now_s()
        phones = {device_id: _Phone(device_id) for device_id in WALKERS}
        while not self._stop.wait(PERIOD_S):
            now_s = clock.now_s()
            for number, phone in enumerate(phones.values()):
                x_m, y_m = _place(number, now_s - start_s)
                phone.hear(now_s, x_m, y_m, rng)
                phone.post_all(self._client)


def _place(number: int, elapsed_s: float) -> tuple[float, float]:
    """Return where walker ``number`` is on its way up and down the yard."""
    along_m = (WALKING_MPS * elapsed_s + 7.0 * number) % 44.0
    x_m = 4.0 + (along_m if along_m < 22.0 else 44.0 - along_m)
    return x_m, 6.0 + 4.0 * number


class _Phone:
    def __init__(self, device_id: str) -> None:
        self._device_id = device_id
        self._session = str(uuid.uuid4())
        self._seq = 0
        self._waiting: list[bytes] = []

    def hear(self, now_s: float, x_m: float, y_m: float, rng: np.random.Generator) -> None:
        floor_id = WALKERS[self._device_id]
        readings = []
        for on_floor, mac, bx_m, by_m in BEACONS.values():
            distance_m = max(1.0, float(np.hypot(x_m - bx_m, y_m - by_m)))
            through_ceiling_db = 0.0 if on_floor == floor_id else 25.0
            level = -59.0 - 20.0 * np.log10(distance_m) - through_ceiling_db + rng.normal(0.0, 1.5)
            readings.append(Reading((f"mac:{mac}",), float(round(level))))
        scan = BleScan(now_s, tuple(readings))
        header = {
            "device": {"id": self._device_id, "platform": "other"},
            "session": self._session,
            "site": SITE_ID,
            "clock": {"sent_ms": now_s * 1000.0},
        }
        self._waiting.append(ingest_body(header, self._seq, [scan]))
        self._seq += 1

    def post_all(self, client: httpx.Client) -> None:
        """Post what waits, oldest first; what a lost server did not acknowledge stays."""
        while self._waiting:
            try:
                reply = client.post(
                    "/v1/ingest",
                    content=self._waiting[0],
                    headers={"Content-Type": "application/json"},
                )
            except httpx.TransportError:
                return
            if reply.status_code in {429, 503}:
                return
            reply.raise_for_status()
            self._waiting.pop(0)
