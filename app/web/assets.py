"""The dashboard's static files, read once and named by their content."""

import hashlib
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable

MEDIA_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
LEAFLET_FILES = ("leaflet-src.esm.js", "leaflet.css")


@dataclass(frozen=True, slots=True)
class Asset:
    """One file as it is served."""

    content: bytes
    media_type: str


@dataclass(frozen=True, slots=True)
class Assets:
    """All files by path, and the version that names exactly this set of contents."""

    by_path: dict[str, Asset]
    version: str


def load_assets() -> Assets:
    """Read the package's own files and those of Leaflet that the page uses."""
    by_path = dict(_walk(files("app.web") / "static"))
    leaflet = files("xstatic.pkg.leaflet") / "data"
    for name in LEAFLET_FILES:
        by_path[f"leaflet/{name}"] = _asset(leaflet / name)
    return Assets(by_path, _version(by_path))


def _walk(folder: Traversable, prefix: str = "") -> list[tuple[str, Asset]]:
    found: list[tuple[str, Asset]] = []
    for entry in folder.iterdir():
        path = prefix + entry.name
        found += _walk(entry, f"{path}/") if entry.is_dir() else [(path, _asset(entry))]
    return found


def _asset(file: Traversable) -> Asset:
    suffix = "." + file.name.rpartition(".")[2]
    return Asset(file.read_bytes(), MEDIA_TYPES[suffix])


def _version(by_path: dict[str, Asset]) -> str:
    digest = hashlib.sha256()
    for path, asset in sorted(by_path.items()):
        digest.update(f"{path}\0{len(asset.content)}\0".encode())
        digest.update(asset.content)
    return digest.hexdigest()[:12]
