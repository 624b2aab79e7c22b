"""The folder of files that are being received and read, which outlives the server."""

import os
import re
import stat
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

_OURS = re.compile(r"[0-9a-f]{32}")
"""Files are named by the job's id: never by what an upload brings."""


class Spool:
    """One file per upload, by its job's id; the folder is made when the first one comes."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, job_id: str) -> Path:
        """Return where an upload's file is, or would be."""
        return self.folder / job_id

    def begin(self, job_id: str) -> None:
        """Make an upload's empty file."""
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self.path(job_id).touch(mode=0o600)

    def size(self, job_id: str) -> int | None:
        """Return how many bytes there are of an upload; None if its file is gone."""
        try:
            return self.path(job_id).stat().st_size
        except FileNotFoundError:
            return None

    def cut(self, job_id: str, size: int) -> None:
        """Forget what lies behind the first ``size`` bytes."""
        os.truncate(self.path(job_id), size)

    def drop(self, job_id: str) -> None:
        """Remove an upload's file."""
        self.path(job_id).unlink(missing_ok=True)

    @contextmanager
    def appending(self, job_id: str, offset: int) -> Iterator[BinaryIO]:
        """Open an upload's file at an offset; what was written is on the disk when this ends."""
        with self.path(job_id).open("r+b") as file:
            file.seek(offset)
            try:
                yield file
            finally:
                to_disk(file)

    def drop_orphans(self, open_jobs: Collection[str], before_s: float) -> int:
        """Remove files of no open upload that nothing was written to since; return how many.

        Whose they are is not known: another server may have the same folder, so they must be old.
        """
        if not self.folder.is_dir():
            return 0
        dropped = 0
        for path in self.folder.iterdir():
            if _OURS.fullmatch(path.name) is None or path.name in open_jobs:
                continue
            try:
                if path.stat().st_mtime < before_s:
                    path.unlink()
                    dropped += 1
            except FileNotFoundError:
                continue
        return dropped


def to_disk(file: BinaryIO) -> None:
    """Make what was written outlive a power cut."""
    file.flush()
    os.fsync(file.fileno())


def own_temporary_folder() -> Path:
    """Return this user's folder for uploads among the system's temporary files.

    Raises
    ------
    PermissionError
        If somebody else has made it.
    """
    folder = Path(tempfile.gettempdir()) / f"pharos-uploads-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
        msg = f"{folder} belongs to somebody else; set PHAROS_SPOOL_DIR"
        raise PermissionError(msg)
    return folder
