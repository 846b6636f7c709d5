"""The compose file as Compose reads it, and what `make demo` does with an engine that is a fake."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from armadico.cli.options import FailedError
from armadico.config.hosts import load_hosts
from armadico_tools.hosts import compose
from armadico_tools.hosts.compose import DRIVES, FILE, ComposeHosts
from tests.house.tree import ROOT

HOSTS = tuple(load_hosts("demo").hosts)


def has_compose() -> bool:
    if shutil.which("docker") is None:
        return False
    command = ["docker", "compose", "version"]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


@pytest.fixture(scope="module")
def described() -> dict[str, Any]:
    """What Compose makes of the file; needs no engine."""
    if not has_compose():
        pytest.skip("Docker Compose v2 is not installed")
    done = subprocess.run(
        ["docker", "compose", "--file", FILE, "config", "--format", "json"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_every_container_has_as_little_as_it_needs(described: dict[str, Any]) -> None:
    for service in described["services"].values():
        assert service["read_only"] is True
        assert service["init"] is True
        assert service["cap_drop"] == ["ALL"]
        assert service["security_opt"] == ["no-new-privileges:true"]
        assert not {"privileged", "cap_add", "ports", "volumes", "network_mode"} & set(service)
        for limit in ("mem_limit", "cpus", "pids_limit"):
            assert float(service[limit]) > 0
        assert service["restart"] == "unless-stopped"
        assert service["healthcheck"]["test"][:2] == ["CMD", "armadico"]


def test_the_network_has_no_way_out_and_holds_the_addresses(described: dict[str, Any]) -> None:
    (network,) = described["networks"].values()
    assert network["internal"] is True
    assert network["ipam"]["config"] == [{"subnet": "10.77.0.0/24"}]


def test_one_image_serves_all(described: dict[str, Any]) -> None:
    services = described["services"]
    assert {service["image"] for service in services.values()} == {compose.IMAGE}
    assert [name for name, service in services.items() if "build" in service] == ["robot"]


def test_what_the_demo_starts_in_a_container_is_in_the_image() -> None:
    """The image holds the folders that its Dockerfile copies, and the products of these alone."""
    copied = [
        line.split()[1]
        for line in (ROOT / "deploy" / "Dockerfile").read_text().splitlines()
        if line.startswith("COPY ") and (ROOT / line.split()[1]).is_dir()
    ]
    assert "armadico" in copied
    found = importlib.util.find_spec(f"armadico.cli.{DRIVES[1]}")
    assert found is not None
    assert found.origin is not None
    assert Path(found.origin).relative_to(ROOT).parts[0] in copied


# With an engine that only records its calls ---------------------------------------------------


class Engine:
    """A command `docker` that notes its words, and fails at those of `failing`."""

    def __init__(self, folder: Path, failing: str = "") -> None:
        self._log = folder / "words"
        program = folder / "docker"
        program.write_text(
            f'#!/bin/sh\necho "$@" >>{self._log}\n'
            f'case "$*" in {failing or "nothing"}*) echo out of order >&2; exit 1;; esac\n'
        )
        program.chmod(0o755)

    @property
    def calls(self) -> list[str]:
        return self._log.read_text().splitlines()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}/usr/bin{os.pathsep}/bin")
    return tmp_path


def verbs(engine: Engine) -> list[str]:
    """The calls of Compose, in order."""
    return [words.split()[1] for words in engine.calls if words.startswith("compose")]


def test_hosts_start_and_stop_as_services_and_nothing_is_left(folder: Path) -> None:
    engine, printed = Engine(folder), list[str]()
    with ComposeHosts("sc4", printed.append) as hosts:
        assert hosts.names == HOSTS
        hosts.stop("lab2")
        hosts.start("lab2")
        process = hosts.popen("lab3", ["armadico", "ps"])
        process.communicate()
    assert verbs(engine) == ["down", "build", "up", "kill", "up", "exec", "down"]
    assert "compose kill lab2" in engine.calls
    assert "compose exec --no-TTY lab3 armadico ps" in engine.calls
    assert any("healthy" in line for line in printed)


def test_what_does_not_come_up_is_taken_down_and_its_words_are_passed_on(folder: Path) -> None:
    engine = Engine(folder, failing="'compose up'")
    with pytest.raises(FailedError, match=r"(?s)docker compose up .* ended with 1.*out of order"):
        ComposeHosts("sc4", lambda _: None).__enter__()
    assert verbs(engine) == ["down", "build", "up", "down"]


def test_ctrl_c_in_the_middle_takes_everything_down(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    engine = Engine(folder)

    def interrupted(*_: object) -> int:
        os.kill(os.getpid(), signal.SIGINT)
        raise AssertionError("the signal comes first")

    monkeypatch.setattr(compose, "demo", interrupted)
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        assert compose.main([]) == 130
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert verbs(engine)[-1] == "down"


@pytest.mark.parametrize(
    ("failing", "reason"),
    [("version", "no engine answers: out of order"), ("'compose version'", "no Compose v2")],
)
def test_without_an_engine_the_error_names_the_alternative(
    failing: str, reason: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Engine(folder, failing)
    assert compose.main([]) == 1
    printed = capsys.readouterr().err
    assert reason in printed
    assert "make run" in printed


def test_a_missing_docker_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert compose.main(["sc4"]) == 1
    assert "the command docker is missing" in capsys.readouterr().err


def test_the_scenario_and_other_peoples_files_reach_compose(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "docker").write_text(f'#!/bin/sh\necho "$SCENARIO $COMPOSE_FILE" >{folder}/seen\n')
    (folder / "docker").chmod(0o755)

    monkeypatch.delenv("COMPOSE_FILE", raising=False)

    def seen() -> Sequence[str]:
        ComposeHosts("house", lambda _: None).start("lab1")
        return (folder / "seen").read_text().split()

    assert seen() == ["house", str(FILE)]
    monkeypatch.setenv("COMPOSE_FILE", "mine.yaml")
    assert seen() == ["house", "mine.yaml"]
