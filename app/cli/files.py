"""Files that commands write."""

from pathlib import Path

from app.cli.errors import CommandError


def write_file(path: Path, content: bytes) -> None:
    """Write a file, or end the command with the reason."""
    try:
        path.write_bytes(content)
    except OSError as error:
        msg = f"{path} cannot be written: {error.strerror}"
        raise CommandError(msg) from error
