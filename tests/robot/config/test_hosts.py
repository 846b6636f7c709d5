"""Host tables: which agents run where, the robot's router, and faults with file and line."""

from __future__ import annotations

from pathlib import Path

import pytest

from armadico.config.hosts import Host, load_hosts, serial_port, unplaced
from armadico.config.scenarios import society
from armadico.core.config_errors import ConfigError

LAB = """\
[robot]
router = "tcp/10.0.0.2:7447"
agents = ["robot", "encoder"]

[lab1]
address = "fe80::1"
agents = ["goto"]

[desk]
"""
"""Where the desk is the table does not say."""


def lab(folder: Path, text: str = LAB) -> Path:
    file = folder / "lab.toml"
    file.write_text(text)
    return file


def test_the_shipped_table_opens_no_port_and_runs_every_agent() -> None:
    table = load_hosts()
    every = (society().robot, *society().agents, *society().watch)
    assert table.hosts == {"localhost": Host(agents=every)}
    assert table.host("localhost").addresses == ()
    assert (table.robots_host, table.robots_router) == ("localhost", None)
    assert table.fleet == ()


def test_a_table_is_a_file_or_a_shipped_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    lab(tmp_path)
    assert list(load_hosts("lab.toml").hosts) == ["robot", "lab1", "desk"]
    with pytest.raises(
        ConfigError, match=r"no host table 'lab'; .*known: demo, localhost.*lab\.toml"
    ):
        load_hosts("lab")
    with pytest.raises(ConfigError, match=r"elsewhere/lab: cannot be read: No such file"):
        load_hosts("elsewhere/lab")


def test_settings_stand_above_the_hosts_and_a_host_may_have_their_names(tmp_path: Path) -> None:
    fleet = "fleet = ['tcp/10.0.0.1:7447', 'tcp/10.0.0.9:7447']\n"
    table = load_hosts(lab(tmp_path, f"{fleet}[a]\nrouter = 'tcp/10.0.0.1:7447'\n"))
    assert table.fleet == ("tcp/10.0.0.1:7447", "tcp/10.0.0.9:7447")
    names = ["fleet", "router", "multicast", "endpoints"]
    table = load_hosts(lab(tmp_path, "".join(f"[{name}]\nagents = ['goto']\n" for name in names)))
    assert list(table.hosts) == names
    assert table.fleet == ()


def test_keys_turn_every_port_of_the_table_into_tls(tmp_path: Path) -> None:
    above = "keys = 'lab-keys'\nfleet = ['tcp/10.0.0.2:7447', 'tls/10.0.0.9:7447']\n"
    table = load_hosts(lab(tmp_path, above + LAB))
    assert table.robots_router == "tls/10.0.0.2:7447"
    assert table.fleet == ("tls/10.0.0.2:7447", "tls/10.0.0.9:7447")
    assert table.keys_folder == tmp_path / "lab-keys"
    assert table.open_port == ""


@pytest.mark.parametrize(
    ("above", "router", "words"),
    [
        ("", "tls/10.0.0.2:7447", r'lab.toml:2: robot.router = "tls/.*": tls needs keys; write'),
        ("", "quic/10.0.0.2:7447", r"quic needs keys"),
        ("keys = 'keys'\n", "udp/10.0.0.2:7447", r"lab.toml:3: .*with keys expected tcp or tls"),
        ("keys = ''\n", "tcp/10.0.0.2:7447", r"lab.toml:1: keys = .*expected a folder"),
        ("keys = 3\n", "tcp/10.0.0.2:7447", r"lab.toml:1: .*keys"),
    ],
)
def test_a_port_that_does_not_fit_the_keys_is_refused(
    tmp_path: Path, above: str, router: str, words: str
) -> None:
    text = LAB.replace("tcp/10.0.0.2:7447", router).lstrip()
    with pytest.raises(ConfigError, match=words):
        load_hosts(lab(tmp_path, above + text))


@pytest.mark.parametrize("address", ["127.0.0.1", "127.1.2.3", "localhost", "[::1]"])
def test_a_port_that_no_other_machine_reaches_needs_no_keys(tmp_path: Path, address: str) -> None:
    assert load_hosts(lab(tmp_path)).open_port == "tcp/10.0.0.2:7447"
    assert load_hosts(lab(tmp_path, LAB.replace("10.0.0.2", address))).open_port == ""


def test_several_hosts_need_a_router_that_they_can_reach(tmp_path: Path) -> None:
    alone = "[robot]\nagents = ['robot']\n"
    assert load_hosts(lab(tmp_path, alone)).robots_router is None
    with pytest.raises(ConfigError) as caught:
        load_hosts(lab(tmp_path, f"[lab1]\naddress = '10.0.0.1'\n{alone}"))
    assert "lab.toml:3: robot runs the robot agent" in str(caught.value)
    assert 'router = "tcp/ADDRESS:7447" in [robot]' in str(caught.value)


def test_a_fleet_that_lacks_the_robots_own_router_is_refused(tmp_path: Path) -> None:
    fleet = "fleet = ['tcp/10.0.0.9:7447', '{}']\n"
    assert load_hosts(lab(tmp_path, fleet.format("tcp/10.0.0.2:7447") + LAB)).fleet
    with pytest.raises(
        ConfigError, match=r"lab\.toml:1: fleet lacks .*tcp/10\.0\.0\.2:7447.*robot"
    ):
        load_hosts(lab(tmp_path, fleet.format("tcp/10.0.0.3:7447") + LAB))
    behind_nat = "[robot]\nagents = ['robot']\n"
    assert load_hosts(lab(tmp_path, fleet.format("tcp/10.0.0.3:7447") + behind_nat)).fleet


def test_the_robots_router_is_that_of_the_host_that_runs_the_robot_agent(tmp_path: Path) -> None:
    table = load_hosts(lab(tmp_path))
    assert (table.robots_host, table.robots_router) == ("robot", "tcp/10.0.0.2:7447")
    own = LAB.replace('"robot", "encoder"', '"own-robot"')
    table = load_hosts(lab(tmp_path, own))
    assert table.robots_host == "robot", "its agent need not be installed here"
    with pytest.raises(
        ConfigError, match=r"lab\.toml:6: lab1\.router = .*only the host of the rob"
    ):
        load_hosts(lab(tmp_path, own.replace("address = ", 'router = "tcp/10.0.0.3:7447" # ')))
    unplaced = LAB.replace('"robot", "encoder"', '"encoder"').replace("router = ", "# ")
    table = load_hosts(lab(tmp_path, unplaced))
    assert (table.robots_host, table.robots_router) == (None, None)


def test_the_controller_of_a_hosts_robot_agent(tmp_path: Path) -> None:
    text = LAB.replace("[lab1]", 'robot = "serial:///dev/ttyUSB0?baud=9600"\n[lab1]')
    table = load_hosts(lab(tmp_path, text))
    url = table.host("robot").robot
    assert url == "serial:///dev/ttyUSB0?baud=9600"
    assert serial_port(url) == Path("/dev/ttyUSB0")
    assert serial_port("tcp://10.0.0.9:8101") is None


def test_who_is_nobodys_is_found(tmp_path: Path) -> None:
    assert unplaced(("robot", "goto", "avoid"), load_hosts(lab(tmp_path))) == ("avoid",)
