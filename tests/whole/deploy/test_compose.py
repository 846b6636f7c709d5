"""The compose file as Compose reads it, and what `make demo` does with an engine that is a fake."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from armadico.config.hosts import load_hosts
from armadico.core.discovery import COMMANDS, find
from armadico.core.judgement import Answer
from armadico_tools.hosts import compose
from armadico_tools.hosts.compose import DESK, FILE, PAGE_PORT, ComposeHosts, Lost, demo, judged
from tests.whole.house.tree import ROOT

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
    for name, service in described["services"].items():
        assert service["read_only"] is True
        assert service["init"] is True
        assert service["cap_drop"] == ["ALL"]
        assert service["security_opt"] == ["no-new-privileges:true"]
        assert not {"privileged", "cap_add", "volumes", "network_mode"} & set(service)
        ports = [(port["host_ip"], port["target"]) for port in service.get("ports", ())]
        assert ports == ([("127.0.0.1", PAGE_PORT)] if name == DESK else [])
        for limit in ("mem_limit", "cpus", "pids_limit"):
            assert float(service[limit]) > 0
        assert service["restart"] == "unless-stopped"
        assert service["healthcheck"]["test"][:2] == ["CMD", "armadico"]


def test_the_network_has_no_way_out_and_holds_the_addresses(described: dict[str, Any]) -> None:
    mesh = described["networks"]["mesh"]
    assert mesh["internal"] is True
    assert mesh["ipam"]["config"] == [{"subnet": "10.77.0.0/24"}]
    outside = {name: {*of["networks"]} - {"mesh"} for name, of in described["services"].items()}
    assert outside == {name: set() for name in HOSTS} | {DESK: {"door"}}


def test_what_the_demo_starts_in_a_container_is_in_the_image() -> None:
    """The image holds the folders that its Dockerfile copies, and the products of these alone."""
    copied = [
        line.split()[1]
        for line in (ROOT / "deploy" / "Dockerfile").read_text().splitlines()
        if line.startswith("COPY ") and (ROOT / line.split()[1]).is_dir()
    ]
    assert "armadico" in copied
    for command in ("up", "run", "ps", "why", "page"):
        path = find(COMMANDS, command).path
        assert path is not None
        assert path.relative_to(ROOT).parts[0] in copied


# With an engine that only records its calls ---------------------------------------------------


class Engine:
    """A command `docker` that notes its words, and fails at those of `failing`."""

    def __init__(self, folder: Path, failing: str = "", prints: str = "127.0.0.1:9") -> None:
        self._log = folder / "words"
        program = folder / "docker"
        program.write_text(
            f'#!/bin/sh\necho "$@" >>{self._log}\n'
            f'case "$*" in "compose port"*) echo {prints};; esac\n'
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
        process = hosts.popen(DESK, ["armadico", "ps"])
        process.communicate()
    assert verbs(engine) == ["down", "build", "up", "port", "kill", "up", "exec", "down"]
    assert "compose kill lab2" in engine.calls
    assert f"compose exec --no-TTY {DESK} armadico ps" in engine.calls
    assert any("healthy" in line for line in printed)


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


# The sequence, on hosts that are a script ---------------------------------------------------------

GOTO, TWIN, AVOID = "goto-a1", "goto-b2", "avoid-a3"


def card(name: str, instance: str, host: str, *holds: str) -> dict[str, Any]:
    return {"name": name, "instance": instance, "host": host, "holds": holds, "answering": True}


CARDS = [
    {"name": "relocate", "instance": "relocate-a4", "answering": False},
    card("goto", TWIN, "lab2"),
    card("goto", GOTO, "lab1", "wheels"),
    card("avoid", AVOID, "lab1"),
    *(card(name, f"{name}-c", "lab2") for name in ("gothrough", "relocate", "monitor")),
]


def why(*drives: tuple[str, str, float, float]) -> str:
    found = [dict(zip(("instance", "host", "begun", "ended"), d, strict=True)) for d in drives]
    return json.dumps({"drives": found})


FAILOVER = why((GOTO, "lab1", 1.0, 5.0), (AVOID, "lab1", 5.1, 6.0), (TWIN, "lab2", 6.2, 30.0))


class Script:
    """Hosts whose commands print what is in `says`, by the command, and exit with its code."""

    names = HOSTS
    recording = "/tmp/demo.mcap"

    def __init__(self, says: dict[str, tuple[int, str]]) -> None:
        self._says = says
        self.done: list[str] = []

    def start(self, host: str) -> None:
        self.done.append(f"start {host}")

    def stop(self, host: str) -> None:
        self.done.append(f"stop {host}")

    def popen(self, host: str, argv: Sequence[str], **options: Any) -> subprocess.Popen[str]:
        words = " ".join(argv[1:])
        self.done.append(f"{host}: {argv[1]}")
        code, text = next(said for start, said in self._says.items() if words.startswith(start))
        return subprocess.Popen(
            ["sh", "-c", 'printf "%s" "$0"; exit "$1"', text, str(code)],
            stdout=subprocess.PIPE,
            text=True,
            **options,
        )


def script(**changes: tuple[int, str]) -> Script:
    """A demo that shows a failover, with changes; `_` in a name stands for a space."""
    says = {
        "run": (0, "sc4 2.1 s, goto drives, 12 V\nsc4 4.2 s, goto drives, 12 V\nsc4: reached\n"),
        "ps --json": (0, json.dumps({"agents": CARDS})),
        "why /tmp/demo.mcap --json": (0, FAILOVER),
        "why /tmp/demo.mcap": (0, "4 exchanges\n1.0 to 5.0 s  goto on lab1 drives\n"),
    }
    return Script({name: changes.get(name.partition(" ")[0], said) for name, said in says.items()})


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The lost host comes back with the next line of the run."""
    monkeypatch.setattr(compose, "AWAY_S", 0.0)


@pytest.mark.usefixtures("at_once")
def test_the_host_that_drives_is_killed_and_comes_back_and_why_is_printed() -> None:
    hosts, said = script(), list[str]()
    judgement = demo(hosts, "sc4", said.append)
    assert judgement.answer is Answer.YES, judgement
    assert "0.20 s after the last obeyed command of lab1, goto on lab2 drove" in judgement.reason
    started = [f"start {name}" for name in HOSTS]
    looked = [f"{DESK}: run", f"{DESK}: ps", "stop lab1", "start lab1", f"{DESK}: ps"]
    assert hosts.done == [*started, *looked, f"{DESK}: why", f"{DESK}: why"]
    assert said[-2:] == ["4 exchanges", "1.0 to 5.0 s  goto on lab1 drives"]
    back = "lab1 is back; gothrough stays on lab2; relocate stays on lab2; monitor stays on lab2"
    assert said[-3] == back


LATE = why((GOTO, "lab1", 1.0, 5.0), (TWIN, "lab2", 13.0, 30.0))
ALONE = why((GOTO, "lab1", 1.0, 5.0))
OTHER = why((TWIN, "lab2", 1.0, 30.0))


@pytest.mark.parametrize(
    ("code", "story", "back", "answer"),
    [
        (0, FAILOVER, True, Answer.YES),
        (0, LATE, True, Answer.NO),
        (0, ALONE, True, Answer.NO),
        (0, OTHER, True, Answer.UNKNOWN),
        (0, "not JSON", True, Answer.UNKNOWN),
        (3, FAILOVER, True, Answer.UNKNOWN),
        (1, FAILOVER, True, Answer.NO),
        (0, FAILOVER, False, Answer.NO),
    ],
)
def test_only_another_host_that_drives_at_once_is_a_failover(
    code: int, story: str, back: bool, answer: Answer
) -> None:
    found = judged(Lost("lab1", frozenset({GOTO, AVOID})), code, story, back=back)
    assert found.answer is answer, found
