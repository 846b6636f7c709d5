"""Host tables: loopback unless an entry says otherwise, and faults named with file and line."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from armadico.config.errors import ConfigError
from armadico.config.hosts import LOOPBACK, Host, load_hosts, nobodys, serial_port
from armadico.config.loading import read_text
from armadico.config.scenarios import society
from armadico.config.shipped import folder

DEMO = {"robot": 11, "lab1": 12, "lab2": 13, "lab3": 14}

LAB = """\
[robot]
endpoints = ["tcp/10.0.0.2:7447", "tls/robot.local:7448"]
agents = ["robot", "encoder"]

[lab1]
endpoints = [
  "tcp/[fe80::1]:7447",
]
agents = ["goto"]

[desk]
"""


def lab(folder: Path, text: str = LAB) -> Path:
    file = folder / "lab.toml"
    file.write_text(text)
    return file


def test_what_is_shipped_stays_on_loopback_and_runs_everybody() -> None:
    table = load_hosts()
    everybody = (society().robot, *society().agents, *society().watch)
    assert table.hosts == {"localhost": Host(LOOPBACK, everybody)}
    assert not table.multicast
    assert table.router is None


def test_the_demos_table_is_four_hosts_that_run_everybody_between_them() -> None:
    hosts = load_hosts("demo").hosts
    assert {name: host.addresses for name, host in hosts.items()} == {
        name: (f"10.77.0.{number}",) for name, number in DEMO.items()
    }
    assert all(len(host.endpoints) == 4 for host in hosts.values())
    everybody = [agent for host in hosts.values() for agent in host.agents]
    assert sorted(everybody) == sorted((society().robot, *society().agents))


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


def test_multicast_and_a_router_are_for_all_and_a_host_may_have_their_names(
    tmp_path: Path,
) -> None:
    table = load_hosts(lab(tmp_path, "multicast = true\n[a]\nendpoints = ['tcp/0.0.0.0:7447']\n"))
    assert table.multicast
    assert table.host("a").endpoints == ("tcp/0.0.0.0:7447",)
    assert table.endpoints() == (), "nobody can connect to that"
    table = load_hosts(lab(tmp_path, "router = 'tcp/10.0.0.1:7447'\n[a]\n[b]\nagents = ['goto']\n"))
    assert table.router == "tcp/10.0.0.1:7447"
    assert table.host("b") == Host((), ("goto",)), "its clients listen on nothing"
    table = load_hosts(lab(tmp_path, "[router]\nendpoints = ['tcp/10.0.0.1:7447']\n"))
    assert list(table.hosts) == ["router"]


def test_the_controller_of_a_hosts_robot_agent(tmp_path: Path) -> None:
    text = LAB.replace("[lab1]", 'robot = "serial:///dev/ttyUSB0?baud=9600"\n[lab1]')
    table = load_hosts(lab(tmp_path, text))
    url = table.host("robot").robot
    assert url == "serial:///dev/ttyUSB0?baud=9600"
    assert serial_port(url) == Path("/dev/ttyUSB0")
    assert serial_port("tcp://10.0.0.9:8101") is None


def test_who_is_nobodys_is_found(tmp_path: Path) -> None:
    assert nobodys(("robot", "goto", "avoid"), load_hosts(lab(tmp_path))) == ("avoid",)


def test_the_examples_in_the_shipped_table_are_a_table(tmp_path: Path) -> None:
    text = read_text(folder("") / "hosts.toml")
    example = "\n".join(line[2:] for line in text.splitlines() if re.match(r"# (\[|\w+ = )", line))
    table = load_hosts(lab(tmp_path, example))
    assert list(table.hosts) == ["robot", "lab1", "lab2", "lab3"]
    every = [agent for host in table.hosts.values() for agent in host.agents]
    assert sorted(every) == sorted((society().robot, *society().agents))


def test_endpoints_are_those_of_the_entries_else_loopback(tmp_path: Path) -> None:
    table = load_hosts(lab(tmp_path))
    assert table.host("robot").endpoints == ("tcp/10.0.0.2:7447", "tls/robot.local:7448")
    assert table.host("lab1").agents == ("goto",)
    assert table.host("desk") == Host(LOOPBACK, ())
    expected = ("tcp/10.0.0.2:7447", "tls/robot.local:7448", "tcp/[fe80::1]:7447", *LOOPBACK)
    assert table.endpoints() == expected


def test_an_unknown_host_is_answered_with_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no host 'lab'; did you mean 'lab1'\? \(known: desk, "):
        load_hosts(lab(tmp_path)).host("lab")


BAD = "expected PROTOCOL/HOST:PORT, for instance tcp/10.0.0.2:7447"


@pytest.mark.parametrize(
    ("endpoint", "message"),
    [
        ("10.0.0.3:7447", BAD),
        ("tcp/10.0.0.3", BAD),
        ("tcp/10.0.0.3:", BAD),
        ("tcp/a b:1", BAD),
        ("tcp/-a:1", BAD),
        ("tcp/:7447", BAD),
        ("tcp/[::g]:7447", BAD),
        ("tcp/fe80::1:7447", BAD),
        ("tcp/10.0.0.3:0", "expected a port from 1 to 65535"),
        ("tcp/10.0.0.3:65536", "expected a port from 1 to 65535"),
        ("tpc/10.0.0.3:7447", "unknown protocol; did you mean 'tcp'?"),
        ("TCP/10.0.0.3:7447", BAD),
        ("tcp/10.0.0.2:7447", "host 'robot' has it already; expected another"),
    ],
)
def test_a_wrong_endpoint_is_named_with_file_and_line(
    tmp_path: Path, endpoint: str, message: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        load_hosts(lab(tmp_path, LAB.replace("tcp/[fe80::1]:7447", endpoint)))
    assert f'lab.toml:7: lab1.endpoints[0] = "{endpoint}": {message}' in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "endpoints = [\n",
            "endpoint = [\n",
            "lab.toml:6: unknown key lab1.endpoint; did you mean",
        ),
        ('["goto"]', '"goto"', 'lab.toml:9: lab1.agents = "goto": expected a list, not a string'),
        ('["goto"]', '["a", "a"]', "lab.toml:9: lab1.agents: 'a' is there twice; expected once"),
        ("[lab1]", "[robot]", "lab.toml:5: a second host 'robot', the first is on line 1"),
        ("[desk]", "[desk]\nrouter = 'tcp/a:1'", "lab.toml:12: router is for all hosts: expected"),
        ("[robot]", "multicast = 1\n[robot]", "lab.toml:1: multicast = 1: expected true or false"),
        ("[robot]", "router = 'a:1'\n[robot]", 'lab.toml:1: router = "a:1": expected PROTOCOL/'),
        ("[robot]", "router = 'tcp/[::]:1'\n[robot]", "nobody can connect to that; expected the"),
        ("[robot]", "multicst = true\n[robot]", "lab.toml:1: multicst = true: expected a table"),
        ("tcp/10.0.0.2:7447", "tcp/0.0.0.0:7447", "or multicast = true above the first host"),
        ("[lab1]", 'robot = "ttyUSB0"\n[lab1]', 'robot.robot = "ttyUSB0": expected serial:///'),
        ("[desk]", '[desk]\nrobot = "tcp://a:1"', 'lab.toml:12: desk.robot = "tcp://a:1": there'),
        ('["goto"]', '["robot"]', "lab.toml:9: lab1.agents: 'robot' has the robot agent already"),
        (LAB, "# nobody\n", "lab.toml:1: no hosts; expected a table for each, [name]"),
        (LAB, "lab1 = 3\n", "lab.toml:1: lab1 = 3: expected a table, not a whole number"),
    ],
)
def test_a_fault_is_named_with_file_line_and_advice(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in LAB
    with pytest.raises(ConfigError) as caught:
        load_hosts(lab(tmp_path, LAB.replace(old, new, 1)))
    assert message in str(caught.value)


def test_two_hosts_that_are_both_on_loopback_are_one_too_many(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"b.endpoints\[0\] = .* host 'a' has it already"):
        load_hosts(lab(tmp_path, "[a]\n[b]\n"))


def test_the_shipped_file_is_toml() -> None:
    assert list(tomllib.loads(read_text(folder("") / "hosts.toml"))) == ["localhost"]
