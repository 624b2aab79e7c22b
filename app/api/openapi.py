"""The OpenAPI document: FastAPI's, with the ingest body, the fix, problems, examples and tokens."""

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from app.api.explanation import EXPLANATION
from app.api.fix_openapi import FIX
from app.api.ingest_openapi import COMPONENTS
from app.api.openapi_examples import add_examples
from app.api.openapi_problems import PROBLEM, add_problems

# What a client may ask before it has a token.
_OPEN = (
    ("get", "/healthz"),
    ("get", "/readyz"),
    ("post", "/v1/login"),
    ("delete", "/v1/login"),
)


def install_openapi(app: FastAPI) -> None:
    """Make ``app.openapi()`` return our document."""

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _document(app)
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]  # as FastAPI documents it


def _document(app: FastAPI) -> dict[str, Any]:
    document = get_openapi(
        title=app.title, version=app.version, description=app.description, routes=app.routes
    )
    components = document.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    schemas |= {**COMPONENTS, "Explanation": EXPLANATION, "Fix": FIX, "Problem": PROBLEM}
    components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
    document["security"] = [{"token": []}]
    for method, path in _OPEN:
        document["paths"][path][method]["security"] = []
    add_problems(document)
    add_examples(document)
    return document
