"""Point surveys as JSON, item by item: our own, and geosubmit's.

Ours: ``{"points": [{"point", "floor_id", "x", "y", "walk"?, "time_s"?, "readings": [{"kind",
"key", "rssi_dbm"}]}]}``. Geosubmit (version 2): ``{"items": [{"timestamp", "position", ...}]}``.
"""

import codecs
import json
import re
from collections.abc import Callable, Iterator
from io import BufferedReader
from typing import Any

from app.core.survey import Surveyed
from app.formats.survey_places import (
    Reason,
    SurveyFrame,
    Unusable,
    UnusableError,
    UploadError,
    number,
    plain_name,
    surveyed_level,
)
from app.formats.survey_tables import GatheredPoint
from app.formats.transmitters import canonical_key, mac_key

MAX_ITEM_CHARACTERS = 1 << 20
_CHUNK_BYTES = 1 << 16
_SPACE = re.compile(r"[\s,]*")


def read_points_json(
    name: str, stream: BufferedReader, frame: SurveyFrame
) -> Iterator[Surveyed | Unusable]:
    """Yield the points of our own JSON."""
    yield from _read(name, stream, "points", lambda item, i: _point(item, frame))


def read_geosubmit(
    name: str, stream: BufferedReader, frame: SurveyFrame
) -> Iterator[Surveyed | Unusable]:
    """Yield the items of a geosubmit body; they name no floor, so the upload has to."""
    yield from _read(name, stream, "items", lambda item, i: _geosubmit_point(item, frame, i))


def _read(
    name: str,
    stream: BufferedReader,
    key: str,
    read_item: Callable[[dict[str, Any], int], GatheredPoint],
) -> Iterator[Surveyed | Unusable]:
    for i, item in enumerate(array_items(stream, key)):
        place = f"{name}:/{key}/{i}"
        if not isinstance(item, dict):
            yield Unusable(place, Reason.UNREADABLE, "not an object")
            continue
        try:
            yield read_item(item, i).surveyed()
        except UnusableError as error:
            yield Unusable(place, error.reason, error.detail)
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            yield Unusable(place, Reason.UNREADABLE, f"{type(error).__name__}: {error}")


def _point(item: dict[str, Any], frame: SurveyFrame) -> GatheredPoint:
    floor = frame.floor(str(item.get("floor_id", "")))
    x_m, y_m = frame.place(floor, number(item.get("x"), "x"), number(item.get("y"), "y"))
    name, walk = plain_name(str(item.get("point", ""))), plain_name(str(item.get("walk", "")))
    gathered = GatheredPoint(name, floor, x_m, y_m, walk)
    if item.get("time_s") is not None:
        gathered.time_s = number(item["time_s"], "time_s")
    for reading in item.get("readings", ()):
        key = canonical_key(str(reading["key"]))
        gathered.hear(str(reading["kind"]), key, surveyed_level(reading["rssi_dbm"]))
    return gathered


def _geosubmit_point(item: dict[str, Any], frame: SurveyFrame, index: int) -> GatheredPoint:
    position = item.get("position", item)
    floor = frame.floor("")
    x_m, y_m = frame.globe_place(
        floor,
        number(position.get("latitude"), "latitude"),
        number(position.get("longitude"), "longitude"),
    )
    gathered = GatheredPoint(f"item {index}", floor, x_m, y_m)
    if item.get("timestamp") is not None:
        gathered.time_s = number(item["timestamp"], "timestamp") / 1000.0
    for kind, field in (("wifi", "wifiAccessPoints"), ("ble", "bluetoothBeacons")):
        for heard in item.get(field, ()):
            # A phone that could not tell the level sends none.
            if "signalStrength" in heard:
                key = mac_key(str(heard["macAddress"]))
                gathered.hear(kind, key, surveyed_level(heard["signalStrength"]))
    return gathered


def array_items(stream: BufferedReader, key: str) -> Iterator[Any]:
    """Yield the items of the array under ``key`` of a JSON object, without reading all of it.

    Raises
    ------
    UploadError
        If it is not UTF-8, not JSON, cut off, or one item is larger than any survey's.
    """
    decoder = json.JSONDecoder(parse_constant=_refuse_constant)
    texts = _texts(stream)
    buffer = _after_bracket(texts, key)
    index = 0
    while True:
        space = _SPACE.match(buffer)
        buffer = buffer[space.end() :] if space else buffer
        if buffer.startswith("]"):
            return
        try:
            item, end = decoder.raw_decode(buffer)
        except (json.JSONDecodeError, RecursionError, _ConstantError) as error:
            buffer = _more(buffer, texts, index, error)
            continue
        yield item
        buffer = buffer[end:]
        index += 1


class _ConstantError(ValueError):
    pass


def _refuse_constant(name: str) -> None:
    raise _ConstantError(name)


def _more(buffer: str, texts: Iterator[str], index: int, error: Exception) -> str:
    if not isinstance(error, json.JSONDecodeError):
        msg = f"item {index} is not JSON of a survey ({error})"
        raise UploadError(msg)
    if len(buffer) > MAX_ITEM_CHARACTERS:
        msg = f"item {index} is not JSON, or longer than any survey's ({error.msg})"
        raise UploadError(msg)
    fresh = next(texts, None)
    if fresh is None:
        msg = f"the JSON is broken or cut off in item {index} ({error.msg})"
        raise UploadError(msg)
    return buffer + fresh


def _after_bracket(texts: Iterator[str], key: str) -> str:
    head = ""
    for text in texts:
        head += text
        if found := re.search(rf'"{key}"\s*:\s*\[', head):
            return head[found.end() :]
        if len(head) > MAX_ITEM_CHARACTERS:
            break
    msg = f"there is no array {key!r} in the JSON"
    raise UploadError(msg)


def _texts(stream: BufferedReader) -> Iterator[str]:
    decoder = codecs.getincrementaldecoder("utf-8-sig")("strict")
    try:
        while chunk := stream.read(_CHUNK_BYTES):
            yield decoder.decode(chunk)
        decoder.decode(b"", final=True)
    except UnicodeDecodeError as error:
        msg = "the JSON is not UTF-8"
        raise UploadError(msg) from error
