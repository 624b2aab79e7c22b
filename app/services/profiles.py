"""The profiles as they are shown: what they read with value, unit and meaning, from the code."""

import dataclasses
import inspect
import math
import re
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

from app.core.engine import PROFILES, Profile
from app.core.params import Params
from app.services.errors import found

Plain: TypeAlias = bool | int | float | str | None
Value: TypeAlias = Plain | list[Plain]
"""A parameter's value in JSON; a number that JSON cannot write is its name."""

Paths: TypeAlias = frozenset[str]
"""Parameters, by block or by block and name."""

_BASES = {
    "m": "m",
    "s": "s",
    "ms": "ms",
    "us": "µs",
    "seconds": "s",
    "hz": "Hz",
    "deg": "°",
    "rad": "rad",
    "dbm": "dBm",
    "db": "dB",
    "ut": "µT",
    "hpa": "hPa",
}
_POWERS = {"": "", "2": "²", "3": "³", "4": "⁴"}
_BASE = "|".join(sorted(_BASES, key=len, reverse=True))
# What a name ends in: `_m`, `_m2`, `_mps2`, `_m2ps4`, `_ps`.
_SUFFIX = re.compile(rf"_(?:({_BASE})([2-4]?))?(?:p({_BASE})([2-4]?))?")
_SECTION = re.compile(r"^Attributes\n-+\n(.*?)(?=^\w[\w ]*\n-+\n|\Z)", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True, slots=True)
class ParameterView:
    """One parameter; ``unit`` is empty where it is a pure number or a word."""

    name: str
    value: Value
    unit: str
    description: str


@dataclass(frozen=True, slots=True)
class ParameterGroup:
    """The parameters of one block, and of the blocks inside it."""

    name: str
    description: str
    parameters: tuple[ParameterView, ...]
    groups: tuple["ParameterGroup", ...]


@dataclass(frozen=True, slots=True)
class ProfileView:
    """A profile: what it is, where it comes from, and all the parameters that it reads."""

    name: str
    title: str
    source: str
    parameters: tuple[ParameterView, ...]
    groups: tuple[ParameterGroup, ...]


def profile_names() -> tuple[str, ...]:
    """Return the names of all profiles, sorted."""
    return tuple(sorted(PROFILES))


def unknown_profile(name: str) -> str:
    """Return the words for a profile that there is not."""
    return f"there is no profile {name!r}; there are: {', '.join(profile_names())}"


def list_profiles() -> list[ProfileView]:
    """Return all profiles, by name."""
    return [_view(PROFILES[name]) for name in profile_names()]


def find_profile(name: str) -> ProfileView:
    """Return one profile.

    Raises
    ------
    AppError
        If there is none of this name.
    """
    return _view(found(PROFILES.get(name), "profile", name))


def unit_of(name: str) -> str:
    """Return the unit that a name ends in, as ``m²/s`` of ``sway_m2ps``; empty if in none."""
    match = _SUFFIX.fullmatch(name[name.rfind("_") :]) if "_" in name else None
    if match is None:
        return ""
    base, power, per, per_power = match.groups(default="")
    if not base and not per:
        return ""
    above = _BASES[base] + _POWERS[power] if base else "1"
    return f"{above}/{_BASES[per]}{_POWERS[per_power]}" if per else above


def _view(profile: Profile) -> ProfileView:
    parameters, groups = _contents(profile.params, _reads(profile))
    return ProfileView(profile.name, profile.title, profile.source, parameters, groups)


def _reads(profile: Profile) -> Paths:
    own = {field.name for field in dataclasses.fields(profile.params)}
    own -= {field.name for field in dataclasses.fields(Params)}
    return frozenset({*own, *profile.reads})


def _inside(name: str, paths: Paths) -> Paths | None:
    """Return which parameters of a block are among some; None: the block is one of them itself."""
    if name in paths:
        return None
    block = f"{name}."
    return frozenset(path.removeprefix(block) for path in paths if path.startswith(block))


def _contents(
    block: Any,  # noqa: ANN401
    reads: Paths | None,
) -> tuple[tuple[ParameterView, ...], tuple[ParameterGroup, ...]]:
    """Return what is read of a block, None: all of it."""
    meanings = attribute_meanings(type(block))
    parameters, groups = [], []
    for field in dataclasses.fields(block):
        inside = None if reads is None else _inside(field.name, reads)
        if inside is not None and not inside:
            continue
        value = getattr(block, field.name)
        meaning = meanings.get(field.name, "")
        if dataclasses.is_dataclass(value):
            contents = _contents(value, inside)
            groups.append(ParameterGroup(field.name, _summary(type(value)), *contents))
        else:
            unit = unit_of(field.name)
            shown = [_plain(v) for v in value] if isinstance(value, tuple) else _plain(value)
            parameters.append(ParameterView(field.name, shown, unit, meaning))
    return tuple(parameters), tuple(groups)


def _plain(value: object) -> Plain:
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    msg = f"a parameter cannot be of type {type(value).__name__}"
    raise TypeError(msg)


def attribute_meanings(block: type) -> dict[str, str]:
    """Return what the docstrings of a class and its bases say of their attributes.

    They are the ``Attributes`` sections of numpydoc: a line with one or more names, then indented
    lines that speak of all of them.
    """
    meanings: dict[str, str] = {}
    for cls in reversed(block.__mro__):
        meanings |= _entries(cls.__dict__.get("__doc__") or "")
    return meanings


@cache
def _entries(docstring: str) -> dict[str, str]:
    section = _SECTION.search(inspect.cleandoc(docstring) + "\n")
    entries: dict[str, str] = {}
    for entry in re.split(r"\n(?=\S)", section[1].strip("\n")) if section else ():
        head, _, text = entry.partition("\n")
        names = re.sub(r" : [^,]*(?:\([^)]*\))?", "", head)
        meaning = " ".join(text.replace("``", "").replace("`", "").split())
        entries |= dict.fromkeys((name.strip() for name in names.split(",")), meaning)
    return entries


def _summary(block: type) -> str:
    return (inspect.cleandoc(block.__doc__ or "").split("\n\n")[0]).replace("\n", " ").rstrip(".")
