"""``/healthz``: the process answers. ``/readyz``: what it needs answers too."""

from fastapi import APIRouter, Request, Response
from fastapi.responses import JSONResponse, PlainTextResponse

from app.api.context import context_of
from app.storage.probe import answers_reads, answers_writes

router = APIRouter(tags=["health"])

_PATIENCE_S = 2.0


@router.get("/healthz", response_class=PlainTextResponse)
async def show_health() -> str:
    """Tell that the process answers."""
    return "ok"


@router.get("/readyz", responses={503: {"description": "One does not answer."}})
async def show_readiness(request: Request) -> Response:
    """Tell of each dependency whether it answers; 503 if one does not."""
    database = context_of(request).database
    answers = {
        "database": await answers_reads(database, _PATIENCE_S),
        "writer": await answers_writes(database, _PATIENCE_S),
    }
    ready = all(answers.values())
    return JSONResponse(
        {"ready": ready, **{name: "ok" if fine else "failed" for name, fine in answers.items()}},
        status_code=200 if ready else 503,
        headers={"Cache-Control": "no-store"},
    )
