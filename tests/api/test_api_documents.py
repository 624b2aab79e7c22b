"""OpenAPI, docs/api.md and the code say the same."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from api_server import ApiServer
from fastapi.openapi.models import OpenAPI

from app.api.errors import STATUS
from app.api.observations import RecordCode
from app.api.stream import StreamCode
from app.config import Settings
from app.core.types import NoFixReason
from app.main import create_app
from app.services.errors import ErrorCode

DOCS = (Path(__file__).parents[2] / "docs" / "api.md").read_text()


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    openapi: dict[str, Any] = create_app(Settings(database_url="sqlite:///unused.db")).openapi()
    return openapi


def references(part: object) -> Iterator[str]:
    if isinstance(part, dict):
        if isinstance(part.get("$ref"), str):
            yield part["$ref"]
        for inner in part.values():
            yield from references(inner)
    elif isinstance(part, list):
        for inner in part:
            yield from references(inner)


def test_the_openapi_document_is_valid(document: dict[str, Any]) -> None:
    OpenAPI.model_validate(document)
    schemas = document["components"]["schemas"]
    for reference in references(document):
        assert reference.removeprefix("#/components/schemas/") in schemas, reference
    operations = [o for path in document["paths"].values() for o in path.values()]
    names = [operation["operationId"] for operation in operations]
    assert len(set(names)) == len(names)


def test_the_ingest_body_is_described_to_its_last_field(document: dict[str, Any]) -> None:
    body = document["paths"]["/v1/ingest"]["post"]["requestBody"]["content"]["application/json"]
    schemas = document["components"]["schemas"]
    batch = schemas[body["schema"]["$ref"].rpartition("/")[2]]
    assert set(batch["required"]) == {"device", "session", "seq", "records"}
    record = schemas[batch["properties"]["records"]["items"]["$ref"].rpartition("/")[2]]
    kinds = record["discriminator"]["mapping"]
    assert set(kinds) == {"wifi", "ble", "step", "pedometer", "imu", "baro", "truth"}
    imu = schemas[kinds["imu"].rpartition("/")[2]]
    assert imu["properties"]["rate_hz"] == {"type": "number", "minimum": 1, "maximum": 1000}


def table(heading: str) -> dict[str, str]:
    """Return first and second column of the table under a heading of docs/api.md."""
    section = DOCS.partition(f"## {heading}\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `([^`]+)` \| ([^|]+) \|", section, re.MULTILINE)
    assert rows, heading
    assert len(rows) == len(dict(rows))
    return {code: second.strip() for code, second in rows}


def test_the_documented_errors_are_those_of_the_code() -> None:
    assert set(STATUS) == set(ErrorCode)
    assert table("Errors") == {code.value: str(status) for code, status in STATUS.items()}


def test_the_documented_record_codes_are_those_of_the_code() -> None:
    assert set(table("Rejected records")) == {code.value for code in RecordCode}


def test_the_documented_reasons_are_those_of_the_code() -> None:
    reasons = {reason.value for reason in NoFixReason} | {"nothing_observed"}
    assert set(table("No fix")) == reasons


def test_the_documented_stream_codes_are_those_of_the_code() -> None:
    section = DOCS.partition("## Live stream\n")[2].partition("\n## ")[0]
    for code in StreamCode:
        assert f"`{code.value}`" in section


@pytest.mark.anyio
async def test_the_documented_examples_are_taken(server: ApiServer) -> None:
    bodies = re.findall(r"curl[^\n]*(/v1/\S+)[^`]*?-d '(\{.*?\})'", DOCS, re.DOTALL)
    assert [path for path, _ in bodies] == ["/v1/ingest", "/v1/locate"]
    async with server.client("admin") as client:
        for path, body in bodies:
            reply = await client.post(path, json=json.loads(body))
            assert reply.status_code == 200, reply.text
            assert reply.json()["rejected"] == []
