"""The dashboard's routes: the page at ``/``, its files under a path that names their contents."""

from typing import Final

from fastapi import APIRouter, FastAPI, HTTPException, Response

from app.web.assets import Assets, load_assets

CONTENT_SECURITY_POLICY: Final = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self'",
        "connect-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)
SECURITY_HEADERS: Final = {
    "Content-Security-Policy": CONTENT_SECURITY_POLICY,
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
# A changed file has another path, so a browser may keep what it has for ever.
IMMUTABLE: Final = "public, max-age=31536000, immutable"


def mount_web(app: FastAPI) -> None:
    """Serve the dashboard from ``app``."""
    app.include_router(_router(load_assets()))


def _router(assets: Assets) -> APIRouter:
    router = APIRouter(include_in_schema=False)
    base = f"/static/{assets.version}"
    page = assets.by_path["index.html"].content.replace(b"{{static}}", base.encode())

    @router.get("/")
    def index() -> Response:
        """Return the page; it is asked for again each time and names the current files."""
        headers = SECURITY_HEADERS | {"Cache-Control": "no-cache"}
        return Response(page, media_type="text/html; charset=utf-8", headers=headers)

    @router.get(base + "/{path:path}")
    def static_file(path: str) -> Response:
        """Return one of the page's files."""
        asset = assets.by_path.get(path)
        if asset is None:
            raise HTTPException(404)
        headers = SECURITY_HEADERS | {"Cache-Control": IMMUTABLE}
        return Response(asset.content, media_type=asset.media_type, headers=headers)

    return router
