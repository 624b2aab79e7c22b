"""The rules of the house that a parser can check."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MAX_FILE_LINES = 400
MAX_BODY_LINES = 60
MAX_README_LINES = 150

BANNED = frozenset(
    {"accuracy", "node", "tag", "data", "info", "helper", "helpers", "util", "utils", "manager"}
    | {"common"}
)
# Names that other people's contracts give: the parser of floor_info.json, msgspec's tag and the
# like are strings or keywords, not names of ours, and need no entry here.
BANNED_BUT = frozenset({"tag_field"})

UNITS = (
    *("m", "m2", "mps", "m2ps", "mps2", "m2ps4", "s", "ms", "us", "seconds", "hz", "ps", "deg"),
    *("dbm", "db", "db2", "rad", "rad2", "radps", "ut", "hpa", "chi2", "v", "percent", "degc"),
)
# Words that end the name of a pure number.
UNITLESS_WORDS = frozenset(
    {"exponent", "weight", "share", "gain", "scale", "confidence", "correlation", "ratio"}
    | {"fraction", "probability", "likelihood", "k", "dof", "sorensen", "inflation"}
)
# Pure numbers under other names, each explained where it is declared; covariances by their axes.
UNITLESS = frozenset(
    {
        *(
            "softness",
            "clutter",
            "concentration",
            "tempering",
            "memory",
            "shrinkage",
            "ridge",
            "trust",
            "total",
        ),
        *("noise_spread", "scale_prior", "scale_walk", "vote_floor", "nis"),
        *("lean", "excess", "residual", "map_residual", "heard", "expected"),
        *("transmitters_per_scan", "xx", "xy", "yy"),
    }
)


@cache
def tracked(pattern: str) -> tuple[Path, ...]:
    listed = subprocess.run(
        ["git", "ls-files", "-z", pattern], cwd=ROOT, capture_output=True, text=True, check=True
    )
    paths = (ROOT / name for name in listed.stdout.split("\0") if name)
    return tuple(path for path in paths if path.exists())


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def sources(folder: str = "") -> list[Path]:
    return [p for p in tracked("*.py") if p.is_relative_to(ROOT / folder)]


def functions(path: Path) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def place(path: Path, node: ast.AST | None = None) -> str:
    line = f":{node.lineno}" if isinstance(node, ast.stmt | ast.expr | ast.arg) else ""
    return f"{path.relative_to(ROOT)}{line}"


def test_files_are_short() -> None:
    long = [place(p) for p in sources() if len(p.read_text().splitlines()) > MAX_FILE_LINES]
    assert not long


def test_functions_are_short() -> None:
    # A migration is a list of columns; it is read once and never changed.
    long = [
        f"{place(path, function)} {function.name}"
        for path in sources()
        if not path.is_relative_to(ROOT / "migrations")
        for function in functions(path)
        if body_lines(function) > MAX_BODY_LINES
    ]
    assert not long


def body_lines(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    body = function.body[1:] if ast.get_docstring(function) is not None else function.body
    return body[-1].end_lineno - body[0].lineno + 1 if body else 0


def test_every_module_says_what_it_is() -> None:
    silent = [place(path) for path in sources("app") if ast.get_docstring(tree(path)) is None]
    assert not silent


def defined_names(path: Path) -> Iterator[tuple[ast.AST, str]]:
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node, node.name
        elif isinstance(node, ast.arg):
            yield node, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node, node.id


def words_of(name: str) -> set[str]:
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)
    return set(spaced.lower().strip("_").split("_"))


def test_no_name_says_nothing() -> None:
    found = [
        f"{place(path, node)} {name}"
        for path in sources("app")
        for node, name in (*defined_names(path), (None, path.stem))
        if words_of(name) & BANNED and name not in BANNED_BUT
    ]
    assert not found


def floats_of(path: Path) -> Iterator[tuple[ast.AST, str]]:
    """Yield the fields, and the parameters of public functions, that are floats.

    Compiled kernels are left out: their letters are those of the equation above them.
    """
    declared: list[tuple[ast.AST, str, ast.expr]] = []
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.ClassDef):
            declared += [
                (field, ast.unparse(field.target), field.annotation)
                for field in node.body
                if isinstance(field, ast.AnnAssign)
            ]
    for function in functions(path):
        is_kernel = any("njit" in ast.unparse(each) for each in function.decorator_list)
        if not (function.name.startswith("_") or is_kernel):
            arguments = (*function.args.args, *function.args.kwonlyargs)
            declared += [(a, a.arg, a.annotation) for a in arguments if a.annotation is not None]
    for node, name, annotation in declared:
        if ast.unparse(annotation) in {"float", "float | None"}:
            yield node, name


def has_unit(name: str) -> bool:
    last = name.rpartition("_")[2]
    return name in UNITLESS or last in UNITLESS_WORDS or last in UNITS


def test_every_float_of_core_tells_its_unit() -> None:
    bare = [
        f"{place(path, node)} {name}"
        for path in sources("app/core")
        for node, name in floats_of(path)
        if not has_unit(name)
    ]
    assert not bare, "\n".join(bare)


def test_the_present_time_comes_from_one_place() -> None:
    calls = re.compile(r"\b(datetime\.now|datetime\.utcnow|time\.time|time_ns|date\.today)\(")
    found = [
        f"{place(path)}: {line.strip()}"
        for path in sources("app")
        for line in path.read_text().splitlines()
        if calls.search(line) and path != ROOT / "app" / "main.py"
    ]
    assert not found


def test_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) < MAX_README_LINES


@pytest.mark.parametrize(
    "pattern",
    [
        r"/" + r"work/",
        r"/tmp/(?!pharos)\w",
        r"/home/\w+/",
        r"/root/",
        r"(files\.)?python" + r"hosted\.org|py" + r"pi\.org|registry\.npmjs|deb\.debian\.org",
    ],
)
def test_nothing_tracked_names_a_machine_or_a_registry(pattern: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}: {line.strip()[:120]}"
        for path in tracked("*")
        if path.suffix not in {".png", ".ico", ".webp", ".xz"}
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.search(pattern, line) and path != Path(__file__)
    ]
    assert not found


def test_constraints_are_names_and_versions_only() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    assert lines == sorted(lines)
    assert not [line for line in lines if not re.fullmatch(r"[a-z0-9._-]+==[0-9][\w.+]*", line)]


def test_import_contracts_hold() -> None:
    linted = subprocess.run(
        [Path(sys.executable).parent / "lint-imports", "--no-cache"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert linted.returncode == 0, linted.stdout + linted.stderr


def test_every_test_module_has_a_name_of_its_own() -> None:
    # pytest imports test modules by their bare names: a second one of a name cannot be collected.
    names = [path.name for path in tracked("tests/*.py") if path.name != "conftest.py"]
    assert sorted(names) == sorted(set(names))
