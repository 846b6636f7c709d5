"""Real processes under a monitor: a dead or hung process is restarted, and a host's agents move."""

from __future__ import annotations

from pathlib import Path
from signal import SIGKILL, SIGSTOP

import pytest

from armadico.launch.processes import kill_trees
from tests.programs import Start
from tests.robot.hosts.conftest import SOON, children, sent_off, write_table
from tests.robot.society import Observer

pytestmark = pytest.mark.live

AGENTS = ("encoder", "sonar", "goto", "avoid", "interface")

SCENARIO = """\
world = "empty"
start = [0, 0, 0]
plan = "direct"
sensors = "ideal"
agents = ["encoder", "sonar", "goto", "avoid", "interface"]
"""


@pytest.fixture
def far(tmp_path: Path) -> str:
    """A scenario whose goal is a long way off."""
    file = tmp_path / "far.toml"
    file.write_text(SCENARIO)
    return str(file)


ALONE = {"robot": ("robot", *AGENTS, "monitor"), "lab3": ()}
FAULTS = (
    (SIGKILL, "encoder"),
    (SIGSTOP, "sonar"),
    (SIGKILL, "goto"),
    (SIGKILL, "interface"),
    (SIGSTOP, "monitor"),
)
"""Either end of a process, and the watcher; tests/robot/launch/test_monitor.py has other agents."""

PAIR = {
    "robot": ("robot", "encoder", "sonar", "monitor"),
    "lab": ("goto", "avoid", "interface", "monitor"),
    "lab3": (),
}


@pytest.fixture(autouse=True)
def table(table: Path, request: pytest.FixtureRequest) -> Path:
    """Another host table, before it is read."""
    write_table(table, request.param)
    return table


def instances(observer: Observer, name: str) -> set[str]:
    return {instance for other, instance in observer.client.alive if other == name}


@pytest.mark.long
@pytest.mark.parametrize("table", [pytest.param(ALONE, id="one host")], indirect=True)
def test_agents_that_are_killed_or_hang_are_back_once_and_the_mission_goes_on(
    up: Start, far: str, observer: Observer
) -> None:
    process = up("robot", far, "--restarts", "50")
    sent_off(observer)
    for number, name in FAULTS:
        (before,) = instances(observer, name)
        children(process)[name].send_signal(number)

        def back(name: str = name, before: str = before) -> bool:
            return bool(instances(observer, name) - {before})

        observer.until(back, f"{name} is back after {number.name}")
        observer.until(observer.driving, f"an agent drives on after {number.name} of {name}")
    process.terminate()
    _, errors = process.communicate(timeout=SOON)
    assert process.returncode == 0, errors
    restarts = [line for line in errors.splitlines() if "it is started again" in line]
    assert len(restarts) == len(FAULTS), errors
    hung = [name for number, name in FAULTS if number == SIGSTOP]
    assert sum("is killed: " in line for line in errors.splitlines()) == len(hung), errors


@pytest.mark.long
@pytest.mark.parametrize("table", [pytest.param(PAIR, id="two hosts")], indirect=True)
def test_what_a_host_had_that_is_gone_is_started_on_another_and_it_may_come_back(
    up: Start, far: str, observer: Observer
) -> None:
    up("robot", far)
    lab = up("lab", far)
    sent_off(observer)
    before = {name: instances(observer, name) for name in ("goto", "avoid", "interface")}
    kill_trees(lab)
    for name, gone in before.items():
        observer.until(lambda n=name, g=gone: instances(observer, n) - g, f"{name} is elsewhere")
    observer.until(observer.driving, "an agent drives on")
    (interface,) = instances(observer, "interface")
    card = observer.client.card("interface", interface)
    assert card is not None
    assert card.host == "robot"
    observer.drives_on(30)  # past its grace: of two newcomers either may stay
    again = up("lab", far)
    observer.until(lambda: len(instances(observer, "monitor")) == 2, "its monitor is back")
    observer.drives_on(30)
    assert instances(observer, "interface") == {interface}
    assert again.poll() is None, "that its agents are elsewhere is no reason to give up"
