"""Uploaded files as bounded streams: plain, gzip, xz or a zip of those, never whole in memory.

Nothing of an archive is ever written under a name that it brings, and nothing is decompressed
beyond a ratio that survey data could have.
"""

import lzma
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BufferedReader, RawIOBase
from pathlib import PurePosixPath
from typing import IO, Protocol

from app.formats.survey_places import Reason, Unusable, UploadError

MAX_RATIO = 200
"""Traces shrink 5 to 15 times, wide tables of mostly "not heard" up to 60 times."""
RATIO_COUNTS_FROM_BYTES = 32 << 20
"""Less than this harms nobody, whatever it was compressed from."""
MAX_MEMBERS = 20_000
MAX_LINE_BYTES = 1 << 20
"""A wide table of 520 access points has lines of 2 kB."""
_XZ_MEMORY_BYTES = 128 << 20
"""xz at its highest preset needs 65 MB to be opened."""
_CHUNK_BYTES = 1 << 16
_GZIP = 16 + zlib.MAX_WBITS
_ZIP_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED = 0x1


@dataclass(slots=True)
class Budget:
    """How many bytes may still come out of an upload of ``sent`` bytes."""

    sent: int
    decoded: int = 0

    def take(self, size: int) -> None:
        """Count decompressed bytes; UploadError once they are too many."""
        self.decoded += size
        if self.decoded > max(RATIO_COUNTS_FROM_BYTES, MAX_RATIO * self.sent):
            msg = f"it grows more than {MAX_RATIO} times when it is decompressed"
            raise UploadError(msg)


@dataclass(frozen=True, slots=True)
class Member:
    """One file of an upload: its bare name (for messages and walks), and its bytes."""

    name: str
    stream: BufferedReader


def members(name: str, file: IO[bytes], size: int) -> Iterator[Member | Unusable]:
    """Yield the files of an upload, decompressed, one after the other.

    Raises
    ------
    UploadError
        If it is empty, cut off, or no archive that may be opened.
    """
    budget = Budget(size)
    head = file.read(6)
    file.seek(0)
    if not head:
        msg = "the upload is empty"
        raise UploadError(msg)
    if not head.startswith(b"PK"):
        yield Member(name, opened(file, head, budget))
        return
    try:
        yield from _zip_members(file, budget)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError) as error:
        msg = f"the zip archive is broken or cut off ({error})"
        raise UploadError(msg) from error


def opened(file: IO[bytes], head: bytes, budget: Budget) -> BufferedReader:
    """Return the decompressed stream of a file that begins with ``head``."""
    if head.startswith(b"\x1f\x8b"):
        return BufferedReader(_Decompressed(file, budget, _GzipDecoder), _CHUNK_BYTES)
    if head.startswith(b"\xfd7zXZ"):
        return BufferedReader(_Decompressed(file, budget, _XzDecoder), _CHUNK_BYTES)
    return BufferedReader(_Plain(file, budget), _CHUNK_BYTES)


def numbered_lines(stream: BufferedReader) -> Iterator[tuple[int, bytes]]:
    """Yield the lines of a stream with their numbers from 1, without line ends.

    Raises
    ------
    UploadError
        If a line is longer than any format's.
    """
    number = 0
    while line := stream.readline(MAX_LINE_BYTES + 1):
        number += 1
        if len(line) > MAX_LINE_BYTES:
            msg = f"line {number} is longer than {MAX_LINE_BYTES >> 20} MB"
            raise UploadError(msg)
        yield number, line.rstrip(b"\r\n")


def _zip_members(file: IO[bytes], budget: Budget) -> Iterator[Member | Unusable]:
    with zipfile.ZipFile(file) as archive:
        listed = archive.infolist()
        if len(listed) > MAX_MEMBERS:
            msg = f"the archive has more than {MAX_MEMBERS} files"
            raise UploadError(msg)
        for entry in listed:
            _check_name(entry.filename)
        for entry in listed:
            if entry.is_dir():
                continue
            name = entry.filename[-100:]
            if entry.flag_bits & _ENCRYPTED or entry.compress_type not in _ZIP_METHODS:
                yield Unusable(name, Reason.NOT_OPENED)
                continue
            with archive.open(entry) as packed:
                head = packed.read(6)
            with archive.open(entry) as packed:
                yield Member(name, opened(packed, head, budget))


def _check_name(name: str) -> None:
    path = PurePosixPath(name.replace("\\", "/"))
    if path.is_absolute() or ".." in path.parts or name[1:2] == ":":
        msg = f"the archive names a file outside of itself: {name[:100]!r}"
        raise UploadError(msg)


class _Plain(RawIOBase):
    """A file as it is; what comes out of an archive counts against the budget."""

    def __init__(self, file: IO[bytes], budget: Budget) -> None:
        self._file = file
        self._budget = budget

    def readable(self) -> bool:
        """Tell that it can be read."""
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]  # a Buffer there
        """Fill the buffer as far as there is something."""
        piece = self._file.read(len(buffer))
        self._budget.take(len(piece))
        buffer[: len(piece)] = piece
        return len(piece)


class _Decoder(Protocol):
    @property
    def eof(self) -> bool: ...
    @property
    def needs_input(self) -> bool: ...
    @property
    def rest(self) -> bytes: ...
    def decompress(self, packed: bytes, max_length: int) -> bytes: ...


class _GzipDecoder:
    """zlib's decoder of one gzip stream, decoded as it is asked for."""

    def __init__(self) -> None:
        self._zlib = zlib.decompressobj(_GZIP)

    @property
    def eof(self) -> bool:
        """Tell whether the stream is over."""
        return self._zlib.eof

    @property
    def needs_input(self) -> bool:
        """Tell whether all that was handed over is decoded."""
        return not self._zlib.unconsumed_tail

    @property
    def rest(self) -> bytes:
        """Return what came after the end of the stream."""
        return self._zlib.unused_data

    def decompress(self, packed: bytes, max_length: int) -> bytes:
        """Return up to ``max_length`` decoded bytes."""
        return self._zlib.decompress(self._zlib.unconsumed_tail + packed, max_length)


class _Decompressed(RawIOBase):
    """One or several compressed streams after each other, decoded piece by piece."""

    def __init__(self, file: IO[bytes], budget: Budget, decoder: Callable[[], _Decoder]) -> None:
        self._file = file
        self._budget = budget
        self._new_decoder = decoder
        self._decoder = decoder()
        self._packed = b""

    def readable(self) -> bool:
        """Tell that it can be read."""
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]  # a Buffer there
        """Fill the buffer as far as there is something."""
        try:
            piece = self._piece(len(buffer))
        except (zlib.error, lzma.LZMAError) as error:
            msg = f"it is broken, or no file of this kind that may be opened ({error})"
            raise UploadError(msg) from error
        self._budget.take(len(piece))
        buffer[: len(piece)] = piece
        return len(piece)

    def _piece(self, size: int) -> bytes:
        while True:
            if self._decoder.eof and not self._begin_next():
                return b""
            fresh = self._packed
            if not fresh and self._decoder.needs_input:
                fresh = self._file.read(_CHUNK_BYTES)
            self._packed = b""
            piece = self._decoder.decompress(fresh, size)
            if piece:
                return piece
            if not fresh and not self._decoder.eof:
                msg = "it is cut off: the compressed file has no end"
                raise UploadError(msg)

    def _begin_next(self) -> bool:
        # Zeros after a stream are padding.
        rest = self._decoder.rest.lstrip(b"\0")
        while not rest and (more := self._file.read(_CHUNK_BYTES)):
            rest = more.lstrip(b"\0")
        if rest:
            self._decoder = self._new_decoder()
            self._packed = rest
        return bool(rest)


class _XzDecoder:
    """lzma's decoder of one xz stream, of bounded memory."""

    def __init__(self) -> None:
        self._lzma = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_XZ_MEMORY_BYTES)

    @property
    def eof(self) -> bool:
        """Tell whether the stream is over."""
        return self._lzma.eof

    @property
    def needs_input(self) -> bool:
        """Tell whether all that was handed over is decoded."""
        return self._lzma.needs_input

    @property
    def rest(self) -> bytes:
        """Return what came after the end of the stream."""
        return self._lzma.unused_data

    def decompress(self, packed: bytes, max_length: int) -> bytes:
        """Return up to ``max_length`` decoded bytes."""
        return self._lzma.decompress(packed, max_length)
