"""How cells of the commands' tables are written."""

from datetime import UTC, datetime


def minute_of(time_s: float) -> str:
    """Return an instant to the minute, UTC."""
    return datetime.fromtimestamp(time_s, UTC).strftime("%Y-%m-%d %H:%M")
