"""``/v1/floors/{id}/predicted-accuracy``: how well a layout of beacons will tell places."""

from collections.abc import Callable
from importlib.util import find_spec

import msgspec
from fastapi import Request, Response

from app.api.auth import check_site
from app.api.negotiation import best_type
from app.api.planner_formats import plan_geojson, plan_json
from app.api.planner_layout import materials_of, request_of_floor
from app.api.planner_openapi import PLAN_REPLY
from app.api.planner_schema import FloorPlan
from app.api.resource import Context, Reader, registry_router
from app.core.georeference import Georeference
from app.services.errors import AppError, ErrorCode, found
from app.services.planning import Frame, PlanRequest, plan, stored_layout
from app.storage import floors

router = registry_router("/v1/floors", "planner")

JSON, GEOJSON, PNG = "application/json", "application/geo+json", "image/png"


@router.post("/{floor_id}/predicted-accuracy", response_class=Response, responses={200: PLAN_REPLY})
async def predict_for_floor(
    floor_id: str, body: FloorPlan, principal: Reader, context: Context, request: Request
) -> Response:
    """Predict the error of the registered beacons, or of drafted ones, over a floor.

    By Accept as JSON, GeoJSON or a PNG picture. Nothing is stored.
    """
    media_type = best_type(request, (JSON, GEOJSON, PNG))
    if media_type == PNG and find_spec("matplotlib") is None:
        detail = "a picture needs matplotlib: install pharos[plots] on the server"
        raise AppError(ErrorCode.NOT_ACCEPTABLE, detail)
    floor = found(
        await context.database.read(lambda c: floors.get_floor(c, floor_id)), "floor", floor_id
    )
    check_site(principal, floor.site_id)
    georeference = context.directory.georeference(floor.site_id)
    if media_type == GEOJSON and georeference is None:
        detail = f"site {floor.site_id!r} has no georeference; ask for JSON or PNG"
        raise AppError(ErrorCode.NO_GEOREFERENCE, detail)
    materials_db = materials_of(body)
    stored = await context.database.read(lambda c: stored_layout(c, floor, materials_db))
    frame = Frame(floor.x0_m, floor.y0_m, floor.width_m, floor.height_m, body.cell_m)
    asked = request_of_floor(body, body.beacons, frame, stored)
    content = await context.plans.run(_work(asked, media_type, georeference))
    return Response(content, 200, {"Vary": "Accept"}, media_type)


def _work(
    asked: PlanRequest, media_type: str, georeference: Georeference | None
) -> Callable[[], bytes]:
    """Return what plans and writes the reply, for a thread."""

    def work() -> bytes:
        result = plan(asked)
        if media_type == PNG:
            from app.api.planner_picture import plan_png  # noqa: PLC0415 - it needs an extra

            return plan_png(asked, result)
        if media_type == GEOJSON and georeference is not None:
            return msgspec.json.encode(plan_geojson(asked, result, georeference))
        return msgspec.json.encode(plan_json(asked, result))

    return work
