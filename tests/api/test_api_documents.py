"""OpenAPI, docs/api.md and the code say the same."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from api_server import NOW_S, ApiServer, batch, ble_record
from fastapi.openapi.models import OpenAPI
from sqlalchemy import Connection

from app.api.errors import STATUS
from app.api.observations import RecordCode
from app.api.openapi_examples import EXAMPLES
from app.api.stream import StreamCode
from app.config import Settings
from app.core.engine.explanation import Use
from app.core.types import NoFixReason
from app.main import create_app
from app.services.errors import ErrorCode
from app.storage.surveys import StoredSurvey, begin_survey, complete_survey

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


async def store_survey(server: ApiServer, site_id: str) -> None:
    def statement(connection: Connection) -> None:
        survey = StoredSurvey("spring", site_id, "Spring", "test", 0.0)
        begin_survey(connection, survey)
        complete_survey(connection, survey)

    await server.app.state.context.database.write(statement)


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


def test_the_documented_uses_are_those_of_the_code() -> None:
    assert set(table("Why a fix is where it is")) == {use.value for use in Use}


def test_the_documented_explanation_has_the_fields_of_the_described_one(
    document: dict[str, Any],
) -> None:
    section = DOCS.partition("## Why a fix is where it is\n")[2]
    example = json.loads(section.partition("```json\n")[2].partition("```")[0])
    described = document["components"]["schemas"]["Explanation"]["properties"]
    assert set(example) == set(described)
    assert set(example["gate"]) == set(described["gate"]["oneOf"][0]["properties"])
    assert set(example["motion"]) == set(described["motion"]["properties"])
    for name in ("candidates", "transmitters", "floors"):
        for part in example[name]:
            assert set(part) == set(described[name]["items"]["properties"])


def test_the_documented_stream_codes_are_those_of_the_code() -> None:
    section = DOCS.partition("## Live stream\n")[2].partition("\n## ")[0]
    for code in StreamCode:
        assert f"`{code.value}`" in section


def test_every_refusal_is_described_as_a_problem(document: dict[str, Any]) -> None:
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            responses = operation["responses"]
            assert ("401" in responses) or operation["security"] == [], (method, path)
            for status, response in responses.items():
                if int(status) >= 400 and path != "/readyz":
                    assert set(response["content"]) == {"application/problem+json"}, (method, path)
    assert "HTTPValidationError" not in document["components"]["schemas"]
    edit = document["paths"]["/v1/floors/{floor_id}"]["patch"]["responses"]
    assert {"404", "409", "412", "413", "415", "422"} <= set(edit)


def test_every_json_body_has_an_example(document: dict[str, Any]) -> None:
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            for media_type, body in operation.get("requestBody", {}).get("content", {}).items():
                if media_type.endswith("json"):
                    assert {"example", "examples"} & {*body, *body["schema"]}, (method, path)


def test_the_docs_name_the_routes_that_there_are(document: dict[str, Any]) -> None:
    paths = {re.sub(r"\{\w+\}", "{id}", path) for path in document["paths"]}
    sockets = {"/v1/ingest/stream", "/v1/stream"}
    named = set(re.findall(r"`(?:[A-Z]+ )?(/v1/[^\s`?]+)", DOCS))
    assert named - sockets <= paths
    resources = {"/".join(path.split("/")[:3]) for path in paths if path.startswith("/v1/")}
    assert resources <= {"/".join(path.split("/")[:3]) for path in named}


@pytest.mark.anyio
async def test_the_examples_of_openapi_are_taken_one_after_the_other(server: ApiServer) -> None:
    ids = {"site_id": "hall", "floor_id": "hall-0", "beacon_id": "entrance", "device_id": "phone-7"}
    ids["feature_id"] = "meeting-room"
    async with server.client("admin") as client:
        truth = {"k": "truth", "t_ms": NOW_S * 1000.0, "floor_id": "lab-0", "x": 6.0, "y": 4.0}
        walked = batch(ble_record(6.0, 4.0, NOW_S * 1000.0), truth, site="lab")
        assert (await client.post("/v1/ingest", json=walked)).status_code == 200
        for (method, path), example in EXAMPLES.items():
            body = {"token": server.secrets["admin"]} if path == "/v1/login" else example
            query = {"site_id": "hall"} if path == "/v1/beacons/import" else {}
            if path == "/v1/radio-maps":
                await store_survey(server, "hall")
            reply = await client.request(method, path.format(**ids), json=body, params=query)
            assert reply.is_success, (method, path, reply.text)
            if path == "/v1/surveys/from-session":
                ids["survey_id"] = reply.json()["survey_id"]
            assert not (path == "/v1/beacons/import" and reply.json()["refused"]), reply.text


@pytest.mark.anyio
async def test_the_documented_examples_are_taken(server: ApiServer) -> None:
    bodies = re.findall(r"curl[^\n]*(/v1/\S+)[^`]*?-d '(\{.*?\})'", DOCS, re.DOTALL)
    assert [path for path, _ in bodies] == ["/v1/ingest", "/v1/locate"]
    async with server.client("admin") as client:
        for path, body in bodies:
            reply = await client.post(path, json=json.loads(body))
            assert reply.status_code == 200, reply.text
            assert reply.json()["rejected"] == []
