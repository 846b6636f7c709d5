"""The four hosts on a real engine: whole, without one, and whole again."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator

import pytest

from armadico_tools.hosts.compose import ComposeHosts, lacking
from tests.house.tree import ROOT

BASE = "python:3.11-slim-bookworm"

pytestmark = [pytest.mark.live, pytest.mark.timeout(400)]


def why_not() -> str | None:
    """Why this cannot be tried here; None if it can."""
    trouble = lacking()
    if trouble is not None:
        return trouble
    if not _quiet("image", "inspect", BASE):
        return f"the engine has no image {BASE}; docker pull {BASE}"
    file = str(ROOT / "deploy" / "compose.yaml")
    if _out("compose", "--file", file, "ps", "--quiet"):
        return "the demo is up on this engine: make demo-down"
    return None


def _quiet(*words: str) -> bool:
    return subprocess.run(["docker", *words], capture_output=True, check=False).returncode == 0


def _out(*words: str) -> str:
    done = subprocess.run(["docker", *words], capture_output=True, text=True, check=False)
    return done.stdout.strip()


@pytest.fixture
def hosts() -> Iterator[ComposeHosts]:
    reason = why_not()
    if reason is not None:
        pytest.skip(reason)
    with ComposeHosts("sc4", print) as up:
        yield up


def ps(hosts: ComposeHosts, host: str) -> tuple[int, str]:
    """What lab3 sees of a host."""
    process = hosts.popen("lab3", ["armadico", "ps", "--host", host])
    output, _ = process.communicate(timeout=30)
    return process.returncode, output


def test_a_host_is_lost_and_comes_back_with_nothing_configured(hosts: ComposeHosts) -> None:
    for host in hosts.names:
        code, output = ps(hosts, host)
        assert code == 0, output
    hosts.stop("lab2")
    code, output = ps(hosts, "lab2")
    assert (code, output) == (1, "lab2: no agent is alive\n")
    assert ps(hosts, "lab1")[0] == 0
    hosts.start("lab2", wait=True)
    code, output = ps(hosts, "lab2")
    assert code == 0, output
