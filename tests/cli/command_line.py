"""What ``pharos`` says when a test runs it."""

from collections.abc import Callable
from typing import NamedTuple


class Result(NamedTuple):
    code: int
    out: str
    err: str


Pharos = Callable[..., Result]
