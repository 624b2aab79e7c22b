"""Parameters of the engine: physics and choices, each with unit, reason and source."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Params:
    """All parameters of one profile."""

    profile: str = "best"
