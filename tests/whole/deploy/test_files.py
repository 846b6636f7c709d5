"""Hosts, packages and locks in deploy/ agree with the rest of the tree."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from armadico.config.hosts import load_hosts
from armadico.observe.watching import MOST_S
from armadico_tools.hosts.compose import DESK, DRIVER
from tests.whole.house.tree import PRODUCT, ROOT

DEPLOY = ROOT / "deploy"
UNIT = DEPLOY / "systemd" / "armadico@.service"
EXECUTABLE = "/opt/armadico/bin/armadico"


def services() -> dict[str, str]:
    """The text of each service in the compose file, read without a parser of YAML."""
    text = (DEPLOY / "compose.yaml").read_text(encoding="utf-8")
    part = re.split(r"^(\w+):.*\n", text, flags=re.MULTILINE)
    inside = part[part.index("services") + 1]
    names = re.split(r"^  (\w+):.*\n", inside, flags=re.MULTILINE)[1:]
    return dict(zip(names[::2], names[1::2], strict=True))


def test_each_service_is_a_host_of_the_demo_at_its_address() -> None:
    hosts = load_hosts("demo").hosts
    assert set(services()) == {*hosts, DESK}
    for name, text in services().items():
        if name == DESK:
            continue
        assert re.findall(r"ipv4_address: ([\d.]+)", text) == list(hosts[name].addresses)
        assert f'command: [up, "${{SCENARIO:-sc4}}", --host, {name}' in text
        assert re.search(rf"test: \[CMD, armadico, ps, --host, {name}\]", text)


def test_a_health_check_is_not_killed_while_it_observes() -> None:
    text = (DEPLOY / "compose.yaml").read_text(encoding="utf-8")
    (timeout,) = re.findall(r"^  timeout: (\d+)s", text, re.MULTILINE)
    assert float(timeout) >= 2 * MOST_S


def test_more_than_one_host_of_the_demo_can_drive_and_has_a_monitor() -> None:
    table = load_hosts("demo")
    drivers = [name for name, host in table.hosts.items() if DRIVER in host.agents]
    assert len(drivers) > 1
    assert table.robots_host not in drivers, "it is never killed"
    assert all("monitor" in table.hosts[name].agents for name in drivers)


def test_the_image_is_given_every_package_and_all_that_it_copies() -> None:
    ignore = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    given = {line[1:] for line in ignore if line.startswith("!")}
    dockerfile = (DEPLOY / "Dockerfile").read_text(encoding="utf-8")
    lines = re.findall(r"^COPY (?!--from)(.+) \S+$", dockerfile, re.MULTILINE)
    copied = {word for line in lines for word in line.split()}
    assert copied == given
    assert set(PRODUCT) <= copied


def test_the_image_installs_what_a_run_on_this_machine_has_without_what_draws() -> None:
    agents, run = (locked(ROOT / "requirements" / f"{name}.txt") for name in ("agents", "run"))
    assert agents < run
    assert "mcap" in {name for name, _ in agents}, "a run is recorded where it is driven"
    assert not {name for name, _ in agents} & {"matplotlib", "rerun-sdk", "scipy"}


def locked(path: Path) -> set[tuple[str, str]]:
    """Names and versions of a lock."""
    found = re.findall(r"^([\w.-]+)==([\w.]+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    assert found
    return set(found)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
def test_systemd_takes_the_unit_without_a_word(tmp_path: Path) -> None:
    text = UNIT.read_text(encoding="utf-8")
    assert text.count(EXECUTABLE) == 1
    unit = tmp_path / UNIT.name.replace("@", "@lab1")
    unit.write_text(text.replace(EXECUTABLE, sys.executable), encoding="utf-8")
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", unit],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout + done.stderr) == (0, "")
