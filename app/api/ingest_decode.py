"""From bytes to batches, and from each record to a core observation in the phone's own time."""

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import msgspec
from msgspec import Raw, Struct

from app.api.ingest_schema import RECORD_TYPES, Record, TruthRecord
from app.api.observations import RecordCode, Refusal, observation_of
from app.core.session import Rejection
from app.services.errors import AppError, ErrorCode, FieldError
from app.sessions.batch import IncomingRecord

Body = TypeVar("Body")

# A text to its end, or what is no JSON but what many serialisers make of such a number.
_TEXT_OR_NOT_FINITE = re.compile(rb'"(?:[^"\\]|\\.)*+\\?"?|-?(?:NaN|Infinity)', re.DOTALL)
# A phone's batch is far smaller; beyond this the search would delay other phones.
_MAX_QUOTED_BYTES = 1 << 20

_PATH_PART = re.compile(r"\.([^.\[]+)|\[(\d+)\]")


class _Kind(Struct):
    k: str


_DECODERS = {kind: msgspec.json.Decoder(model) for kind, model in RECORD_TYPES.items()}


@dataclass(frozen=True, slots=True)
class DecodedRecords:
    """What became of a batch's records.

    Attributes
    ----------
    digest
        Of the records' meaning: spacing, field order and unknown fields of good records are not
        in it, so a retry encoded anew is the same batch.
    """

    accepted: tuple[IncomingRecord, ...]
    rejected: tuple[Rejection, ...]
    ignored: int
    digest: bytes


def decode_body(body: bytes, decoder: msgspec.json.Decoder[Body]) -> Body:
    """Return the envelope of a body; records stay raw.

    NaN and Infinity are no JSON. They are taken for texts: where a number must be, a text is the
    wrong type, and only that record is refused, with a pointer to the place.

    Raises
    ------
    AppError
        400 if it is not JSON in UTF-8, 422 with a pointer if a field is wrong.
    """
    try:
        body.decode()
        return _decoded(body, decoder)
    except msgspec.ValidationError as error:
        _, pointer, detail = _explain(error)
        raise AppError(
            ErrorCode.INVALID_FIELD,
            "the body has a field that is not valid",
            errors=(FieldError(f"#{pointer}", detail),),
        ) from error
    except (UnicodeDecodeError, msgspec.DecodeError) as error:
        raise AppError(ErrorCode.MALFORMED_BODY, f"the body is not JSON: {error}") from error
    except RecursionError as error:
        raise AppError(ErrorCode.MALFORMED_BODY, "the body is nested too deeply") from error


def _decoded(body: bytes, decoder: msgspec.json.Decoder[Body]) -> Body:
    try:
        return decoder.decode(body)
    except msgspec.ValidationError:
        raise
    except msgspec.DecodeError:
        # Only now: bodies that are JSON are not searched.
        quoted = _not_finite_quoted(body) if len(body) <= _MAX_QUOTED_BYTES else body
        if quoted == body:
            raise
        return decoder.decode(quoted)


def _not_finite_quoted(body: bytes) -> bytes:
    if b"NaN" not in body and b"Infinity" not in body:
        return body
    return _TEXT_OR_NOT_FINITE.sub(_quoted, body)


def _quoted(match: re.Match[bytes]) -> bytes:
    # As long as before: what is wrong elsewhere is told by its byte in the body.
    return match[0] if match[0].startswith(b'"') else b'"%b"' % match[0][1:-1]


def decode_records(records: Sequence[Raw], *, may_state_truth: bool) -> DecodedRecords:
    """Decode every record on its own: a bad one takes nobody with it."""
    digest = hashlib.blake2b(digest_size=16)
    accepted: list[IncomingRecord] = []
    rejected: list[Rejection] = []
    ignored = 0
    for index, raw in enumerate(records):
        record = _decode_record(raw)
        digest.update(msgspec.json.encode(record) if isinstance(record, Struct) else bytes(raw))
        if record is None:
            ignored += 1
            continue
        verdict = _judge(index, record, may_state_truth=may_state_truth)
        if isinstance(verdict, Rejection):
            rejected.append(verdict)
        else:
            accepted.append(verdict)
    return DecodedRecords(tuple(accepted), tuple(rejected), ignored, digest.digest())


def _judge(
    index: int, record: Record | Refusal, *, may_state_truth: bool
) -> IncomingRecord | Rejection:
    try:
        if isinstance(record, Refusal):
            raise record
        _check_role(record, may_state_truth=may_state_truth)
        return observation_of(index, record)
    except Refusal as refusal:
        pointer = f"#/records/{index}{refusal.pointer}"
        return Rejection(index, refusal.code, pointer, str(refusal))


def rejection_json(rejection: Rejection) -> dict[str, str | int]:
    """Return what the reply says of a record that was not taken."""
    return {
        "i": rejection.index,
        "code": str(rejection.code),
        "pointer": rejection.pointer or f"#/records/{rejection.index}",
        "detail": rejection.detail,
    }


def _check_role(record: Record, *, may_state_truth: bool) -> None:
    if isinstance(record, TruthRecord) and not may_state_truth:
        raise Refusal(RecordCode.ROLE_FORBIDDEN, "/k", "only surveyors and admins state the truth")


def _decode_record(raw: Raw) -> Record | Refusal | None:
    """Return the record, what is wrong with it, or None if its kind is not one that we use."""
    try:
        kind = msgspec.json.decode(raw, type=_Kind).k
        return _DECODERS[kind].decode(raw) if kind in _DECODERS else None
    except msgspec.DecodeError as error:
        return Refusal(*_explain(error))


def _explain(error: msgspec.DecodeError) -> tuple[RecordCode, str, str]:
    """Return code, JSON pointer and words of msgspec's ``<words> - at `$.a[0].b```."""
    words, _, path = str(error).partition(" - at `$")
    parts = [name or index for name, index in _PATH_PART.findall(path.rstrip("`"))]
    if words.startswith("Object missing required field"):
        parts.append(words.split("`")[1])
    pointer = "".join(f"/{part}" for part in parts)
    return _code_of(words), pointer, words


def _code_of(words: str) -> RecordCode:
    """Classify msgspec's words; a test holds every form of them that the schema can cause."""
    if words.startswith("Object missing"):
        return RecordCode.MISSING_FIELD
    if ", got `" in words or words == "Expected `str`":
        return RecordCode.WRONG_TYPE
    if "of length" in words:
        return RecordCode.TOO_LONG if "<=" in words else RecordCode.LENGTH_MISMATCH
    if words.startswith("Number out of range") or re.search(r"[<>]=? ", words):
        return RecordCode.OUT_OF_RANGE
    return RecordCode.WRONG_FORMAT
