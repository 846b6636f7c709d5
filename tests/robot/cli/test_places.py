"""Where a process is, by the host table, the command line, the environment and its addresses."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from armadico.cli import down, main
from armadico.cli.options import Mesh
from armadico.config.endpoints import Endpoints
from armadico.core.config_errors import ConfigError
from armadico.launch.pidfile import PidFile, Share
from armadico.mesh.topology import HOSTS_VARIABLE, Topology

ROBOTS = "tcp/203.0.113.1:7447"

TABLE = f"""\
[robot]
router = "{ROBOTS}"
agents = ["robot"]

[lab1]
address = "127.0.0.21"
agents = ["goto"]
"""

DESK = '[desk]\nagents = ["avoid"]\n'
"""A host of which the table does not say where it is: behind NAT, for example."""

Captured = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv(HOSTS_VARIABLE, raising=False)
    file = tmp_path / "lab.toml"
    file.write_text(TABLE)
    return file


def found(*, passing: bool = False, **given: Any) -> Endpoints:
    """Where an agent is with these options, or a tool."""
    return Mesh(**{"namespace": "places", "open": True, **given}).endpoints(passing=passing)


def test_a_host_alone_is_the_shipped_tables_which_opens_no_port() -> None:
    where = found(host="localhost")
    assert where.name == "localhost"
    assert where.topology(router=True) == Topology(router=True)
    assert where.topology() == Topology()


def test_this_machine_is_found_by_its_address(table: Path) -> None:
    assert found(hosts=table).name == "lab1"


def test_a_machine_with_no_address_of_the_table_is_the_one_host_that_has_none(table: Path) -> None:
    elsewhere = TABLE.replace("127.0.0.21", "203.0.113.2")
    table.write_text(elsewhere + DESK)
    assert found(hosts=table).name == "desk"
    table.write_text(TABLE + DESK)
    assert found(hosts=table).name == "lab1", "its address says so"
    table.write_text(elsewhere + DESK + DESK.replace("desk", "other"))
    with pytest.raises(ConfigError, match=r"more than one host is .*: desk, other"):
        found(hosts=table)
    assert found(hosts=table, host="other").name == "other"


def test_other_hosts_connect_to_the_robots_router_and_open_no_port(table: Path) -> None:
    table.write_text(TABLE.replace("203.0.113.1", "127.0.0.22") + DESK)
    robot, lab1, desk = (found(hosts=table, host=name) for name in ("robot", "lab1", "desk"))
    robots = ("tcp/127.0.0.22:7447",)
    assert robot.topology(router=True) == Topology(router=True, listen=robots)
    assert robot.topology() == Topology(connect=robots), "the socket comes first"
    assert lab1.topology() == Topology(connect=robots, socket=False)
    assert desk.topology() == Topology(connect=robots, socket=False)


def test_a_machine_that_is_in_no_table_reaches_the_robots_router(table: Path) -> None:
    table.write_text(TABLE.replace("127.0.0.21", "203.0.113.2"))
    where = found(passing=True, hosts=table)
    assert where.topology() == Topology(connect=(ROBOTS,))


def test_what_is_asked_to_be_connected_to_is_the_only_router_that_is_tried(table: Path) -> None:
    where = found(hosts=table, connect=(ROBOTS,))
    assert where.topology() == Topology(connect=(ROBOTS,), socket=False)


FLEET = [f"tcp/127.0.0.{number}:7447" for number in (31, 32, 33)]


@pytest.mark.parametrize("own", [*FLEET, None])
def test_a_robot_knows_the_routers_of_all_others_of_its_fleet(table: Path, own: str | None) -> None:
    router = "" if own is None else f'router = "{own}"\n'
    table.write_text(f'fleet = {FLEET}\n[robot]\n{router}agents = ["robot"]\n')
    where = found(hosts=table)
    assert where.topology(router=True).peers == tuple(each for each in FLEET if each != own)
    assert where.topology().peers == (), "others have nothing to do with it"


def test_the_environment_names_a_table_unless_the_command_line_says_where_to_look(
    table: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(HOSTS_VARIABLE, str(table))
    assert found().table is not None
    assert found(connect=("tcp/10.0.0.9:7447",)).table is None
    with pytest.raises(ConfigError, match=r"no host 'localhost'; .*known: lab1, robot"):
        found(host="localhost")
    monkeypatch.setenv(HOSTS_VARIABLE, "elsewhere.toml")
    assert found(passing=True, hosts=table).table is not None


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (TABLE.partition("[lab1]")[0], "none of its hosts is this machine; expected --host, one"),
        (TABLE.replace("203.0.113.1", "127.0.0.22"), "more than one host is this machine"),
    ],
)
def test_an_agent_must_know_where_it_is_a_tool_need_not(table: Path, text: str, what: str) -> None:
    table.write_text(text)
    with pytest.raises(ConfigError, match=what):
        found(hosts=table)
    assert found(passing=True, hosts=table).table is not None


def test_a_name_that_nobody_knows_is_no_address_of_this_machine(table: Path) -> None:
    table.write_text(TABLE.replace("203.0.113.1", "robot.invalid"))
    with pytest.raises(ConfigError, match=r"the name robot\.invalid is not known here"):
        found(hosts=table, host="robot")


def test_the_shares_of_one_table_are_ended(
    table: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    ended: list[str] = []
    monkeypatch.setattr(down, "_end_share", lambda share: ended.append(share.host))
    with ExitStack() as stack:
        for host in ("lab1", "elsewhere"):
            file = stack.enter_context(PidFile("places", host))
            file.write(Share(1, host, "places", ("goto",), ""))
        assert main(["down", "--namespace", "places", "--hosts", str(table)]) == 0
    assert ended == ["lab1"]
    assert main(["down", "--namespace", "places", "--hosts", str(table), "--host", "lab9"]) == 2
    assert "no host 'lab9'" in capsys.readouterr().err


def test_agents_do_not_use_a_port_that_is_open_to_other_machines_unasked(table: Path) -> None:
    words = r"lab.toml: any program that reaches tcp/203\.0\.113\.1:7447 could drive the robot"
    with pytest.raises(ConfigError, match=words):
        found(hosts=table, open=False)
    assert found(hosts=table, open=False, passing=True).name == "lab1", "a stop goes out anyway"
    where = found(hosts=table, open=True)
    assert where.words[-1] == "--open", "its processes are asked, too"
    assert found(hosts=table).table == where.table


def test_every_command_knows_the_open_port_by_the_table_or_by_what_runs_here(table: Path) -> None:
    mesh = Mesh(namespace="places", hosts=str(table))
    assert mesh.demand().open == "tcp/203.0.113.1:7447"
    assert Mesh(namespace="places").demand().open == ""
    with PidFile("places", "lab1") as file:
        file.write(Share(1, "lab1", "places", ("goto",), "", "tcp/203.0.113.1:7447"))
        assert Mesh(namespace="places").demand().open == "tcp/203.0.113.1:7447"


def test_the_robots_of_a_fleet_are_reached_by_one_table_and_its_keys(table: Path) -> None:
    robots = ("tcp/203.0.113.1:7447", "tcp/203.0.113.9:7447")
    table.write_text(f"keys = 'keys'\nfleet = {list(robots)}\n{TABLE}")
    where = found(hosts=table, connect=robots, passing=True)
    assert where.connect == ("tls/203.0.113.1:7447", "tls/203.0.113.9:7447")
    assert where.keys == table.parent / "keys"
    with pytest.raises(ConfigError, match=r"--connect tls/203\.0\.113\.8:7447 contradicts"):
        found(hosts=table, connect=("tcp/203.0.113.8:7447",), passing=True)
