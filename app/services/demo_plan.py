"""The simulated warehouse as an admin would enter it: plan images and floor maps."""

import io
from typing import Any, TypeAlias

from PIL import Image, ImageDraw, ImageFont
from shapely.geometry import LineString, Polygon, box

from app.core.simulate import ConnectorKind, Rack, Storey
from app.core.simulate.building import CELL_M, CONNECTORS, HEIGHT_M, WIDTH_M, walls_of
from app.formats.floor_map import floor_map_document

Colour: TypeAlias = tuple[int, int, int, int]

PX_PER_M = 20
# Translucent on nothing: the same image lies on the light and on the dark sheet.
RACK: Colour = (112, 132, 156, 62)
WALL: Colour = (112, 130, 150, 235)
STEP: Colour = (112, 130, 150, 130)
LABEL: Colour = (112, 130, 150, 255)
STEP_DEPTH_M = 0.6
LINE_PX = 5


def plan_png(storey: Storey) -> bytes:
    """Return the plan of a storey as a PNG that covers the whole floor."""
    image = Image.new("RGBA", (round(WIDTH_M * PX_PER_M), round(HEIGHT_M * PX_PER_M)), (0, 0, 0, 0))
    draw = ImageDraw.Draw(image)
    for rack in storey.racks:
        draw.rectangle(_pixels(rack), fill=RACK)
    for connector in CONNECTORS:
        if connector.kind is ConnectorKind.STAIRS:
            _draw_flight(draw, connector.footprint)
        else:
            _draw_cabin(draw, connector.footprint)
    for x0, y0, x1, y1 in (*storey.partitions, *storey.masonry):
        draw.line([_pixel(x0, y0), _pixel(x1, y1)], fill=WALL, width=LINE_PX)
    draw.rectangle((0, 0, image.width - 1, image.height - 1), outline=WALL, width=LINE_PX)
    for connector in CONNECTORS:
        _label(draw, connector.footprint, connector.kind.value.capitalize())
    png = io.BytesIO()
    image.save(png, format="PNG", optimize=True)
    return png.getvalue()


def floor_map(storey: Storey) -> dict[str, Any]:
    """Return walls, racks and the walkable outline of a storey as a floor map document."""
    racks = [_box(rack) for rack in storey.racks]
    reach_m = CELL_M / 2.0
    thick_walls = [
        box(
            min(x0, x1) - reach_m,
            min(y0, y1) - reach_m,
            max(x0, x1) + reach_m,
            max(y0, y1) + reach_m,
        )
        for x0, y0, x1, y1 in (*storey.partitions, *storey.masonry)
    ]
    document = floor_map_document([box(0.0, 0.0, WIDTH_M, HEIGHT_M)], [*racks, *thick_walls])
    for wall in walls_of(storey):
        line = LineString([(wall.x0_m, wall.y0_m), (wall.x1_m, wall.y1_m)])
        (feature,) = floor_map_document(walls=[line])["features"]
        feature["properties"]["attenuation_db"] = wall.attenuation_db
        document["features"].append(feature)
    return document


def _box(rack: Rack) -> Polygon:
    return box(rack.x0_m, rack.y0_m, rack.x0_m + rack.width_m, rack.y0_m + rack.depth_m)


def _pixel(x_m: float, y_m: float) -> tuple[float, float]:
    """Return the image's pixel of a place; rows grow downward, y grows upward."""
    return (x_m * PX_PER_M, (HEIGHT_M - y_m) * PX_PER_M)


def _pixels(rack: Rack) -> tuple[float, float, float, float]:
    left, bottom = _pixel(rack.x0_m, rack.y0_m)
    return (left, bottom - rack.depth_m * PX_PER_M, left + rack.width_m * PX_PER_M, bottom)


def _draw_flight(draw: ImageDraw.ImageDraw, footprint: Rack) -> None:
    left, top, right, bottom = _pixels(footprint)
    steps = round(footprint.depth_m / STEP_DEPTH_M)
    for i in range(1, steps):
        row = top + (bottom - top) * i / steps
        draw.line([(left, row), (right, row)], fill=STEP, width=2)


def _draw_cabin(draw: ImageDraw.ImageDraw, footprint: Rack) -> None:
    left, top, right, bottom = _pixels(footprint)
    draw.line([(left, top), (right, bottom)], fill=STEP, width=2)
    draw.line([(left, bottom), (right, top)], fill=STEP, width=2)


def _label(draw: ImageDraw.ImageDraw, footprint: Rack, words: str) -> None:
    left, top, right, _ = _pixels(footprint)
    font = ImageFont.load_default(size=18)
    draw.text(((left + right) / 2.0, top - 14), words, fill=LABEL, font=font, anchor="mm")
