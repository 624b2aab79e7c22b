"""The image and the compose file: what can be said of them without a Docker engine."""

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Instruction:
    name: str
    arguments: str


def instructions(text: str) -> list[Instruction]:
    """Return a Dockerfile's instructions: comments dropped, continued lines joined."""
    kept = "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("#"))
    joined = re.sub(r"\\\n\s*", " ", kept)
    rows = [line.strip().partition(" ") for line in joined.splitlines() if line.strip()]
    return [Instruction(name.upper(), arguments.strip()) for name, _, arguments in rows]


@pytest.fixture(scope="module")
def dockerfile() -> list[Instruction]:
    return instructions((ROOT / "Dockerfile").read_text())


@pytest.fixture(scope="module")
def compose() -> dict[str, Any]:
    loaded: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
    return loaded


def last_stage(dockerfile: list[Instruction]) -> list[Instruction]:
    starts = [i for i, each in enumerate(dockerfile) if each.name == "FROM"]
    assert len(starts) == 2, "one stage to build, one to run"
    return dockerfile[starts[-1] :]


def test_both_stages_use_the_slim_image_of_the_supported_python(
    dockerfile: list[Instruction],
) -> None:
    images = [each.arguments.split()[0] for each in dockerfile if each.name == "FROM"]
    assert images == ["python:3.11-slim"] * 2


def test_the_server_does_not_run_as_root(dockerfile: list[Instruction]) -> None:
    stage = last_stage(dockerfile)
    users = [each.arguments for each in stage if each.name == "USER"]
    assert users
    assert users[-1] not in {"root", "0"}
    after_user = stage[[each.name for each in stage].index("USER") :]
    assert not [each for each in after_user if each.name == "RUN"]


def test_the_image_asks_its_own_health_and_serves(dockerfile: list[Instruction]) -> None:
    stage = {each.name: each.arguments for each in last_stage(dockerfile)}
    assert "/healthz" in stage["HEALTHCHECK"]
    assert stage["CMD"] == '["pharos", "serve"]'


def test_the_image_holds_an_installed_package_not_a_checkout(
    dockerfile: list[Instruction],
) -> None:
    copied = [each.arguments for each in last_stage(dockerfile) if each.name == "COPY"]
    assert copied == ["--from=build /opt/pharos /opt/pharos"]
    installs = [each.arguments for each in dockerfile if "pip install" in each.arguments]
    assert installs
    assert not [each for each in installs if re.search(r"\s(-e|--editable)\s", each)]
    assert all("-c constraints.txt" in each for each in installs)


def test_what_the_build_copies_exists_and_is_not_ignored(dockerfile: list[Instruction]) -> None:
    let_in = {
        line[1:] for line in (ROOT / ".dockerignore").read_text().split() if line.startswith("!")
    }
    for each in dockerfile:
        if each.name == "COPY" and not each.arguments.startswith("--from"):
            for source in each.arguments.split()[:-1]:
                assert (ROOT / source).exists(), source
                assert source in let_in, source


@pytest.mark.parametrize("name", ["Dockerfile", "docker-compose.yml", ".env.example"])
def test_no_secret_is_written_down(name: str) -> None:
    for line in (ROOT / name).read_text().splitlines():
        secret = re.match(r"(?i)[\s-]*\w*(password|token|secret|key)\w*\s*[:=]\s*(\S+)", line)
        if secret:
            assert secret.group(2).startswith("${"), line


def test_the_server_waits_for_a_healthy_database(compose: dict[str, Any]) -> None:
    services = compose["services"]
    assert services["server"]["depends_on"]["database"]["condition"] == "service_healthy"
    assert services["database"]["healthcheck"]["test"][0] == "CMD"
    assert services["server"]["environment"]["PHAROS_DATABASE_URL"].startswith(
        "postgresql+psycopg://"
    )


def test_state_is_kept_in_volumes_and_only_the_server_is_published(
    compose: dict[str, Any],
) -> None:
    services = compose["services"]
    mounted = {entry.split(":")[0] for each in services.values() for entry in each["volumes"]}
    assert mounted == set(compose["volumes"])
    assert "ports" not in services["database"]
    assert services["server"]["ports"][0].startswith("${PHAROS_BIND:-127.0.0.1}")


def test_every_variable_of_the_compose_file_is_in_the_example(compose: dict[str, Any]) -> None:
    asked = set(re.findall(r"\$\{(\w+)", str(compose)))
    offered = set(re.findall(r"^(\w+)=", (ROOT / ".env.example").read_text(), re.MULTILINE))
    assert asked == offered


def test_the_compose_client_accepts_the_file() -> None:
    docker = shutil.which("docker")
    if (
        docker is None
        or subprocess.run(
            [docker, "compose", "version"], capture_output=True, check=False
        ).returncode
    ):
        pytest.skip("no docker client with the compose command here")
    shown = subprocess.run(
        [docker, "compose", "-f", ROOT / "docker-compose.yml", "config", "--quiet"],
        env={"PATH": "/usr/bin:/bin:/usr/local/bin", "POSTGRES_PASSWORD": "x"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert shown.returncode == 0, shown.stderr
