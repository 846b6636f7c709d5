"""How a process joins the mesh: where a router listens, and what a client connects to."""

from __future__ import annotations

import pytest

from armadico.mesh.topology import Topology, TopologyError, checked_namespace, topology

ROBOT = "tcp/10.0.0.1:7447"
SECOND = "tcp/10.0.0.2:7447"
OTHER = "tcp/192.168.1.5:7447"


def test_without_configuration_a_process_is_a_client_of_the_socket_on_this_computer() -> None:
    assert topology() == Topology(router=False, listen=(), connect=(), socket=True)


def test_without_configuration_a_router_listens_on_no_endpoint_but_the_socket() -> None:
    assert topology(router=True) == Topology(router=True, listen=(), connect=(), socket=True)


def test_with_a_host_table_a_client_may_use_the_socket_or_the_robots_endpoint() -> None:
    assert topology(robot=ROBOT) == Topology(connect=(ROBOT,), socket=True)


def test_a_client_on_a_host_that_is_not_the_robots_uses_the_endpoint_only() -> None:
    assert topology(robot=ROBOT, here=False) == Topology(connect=(ROBOT,), socket=False)


def test_a_router_listens_on_the_robots_endpoint_and_links_to_the_rest_of_the_fleet() -> None:
    where = topology(router=True, robot=ROBOT, peers=[ROBOT, SECOND, OTHER])
    assert where == Topology(router=True, listen=(ROBOT,), peers=(SECOND, OTHER))


@pytest.mark.parametrize(
    "endpoint",
    [
        *(ROBOT, "tls/robot.local:7447", "tcp/[fe80::1]:7447", "tcp/10.0.0.1:7447#iface=eth0"),
        *("tls/lab1:7447?rel=0", "unixsock-stream//run/user/1000/armadico/robot1.sock"),
    ],
)
def test_an_endpoint_names_a_protocol_and_an_address_or_a_path(endpoint: str) -> None:
    assert topology(connect=endpoint).connect == (endpoint,)


@pytest.mark.parametrize(
    "text",
    [
        *("", "7447", "tcp/", "tcp/host", "tcp/host:", "host:7447", "unixsock-stream/robot1.sock"),
        *("tcp/host:65536", "tcp/host:99999999999", "tcp/host:\u00b9"),
    ],
)
@pytest.mark.parametrize("option", ["connect", "robot"])
def test_text_that_is_no_endpoint_is_refused_with_an_example(text: str, option: str) -> None:
    with pytest.raises(TopologyError, match=r"tcp/192\.168\.1\.5:7447"):
        topology(**{option: [text] if option == "connect" else text})  # type: ignore[arg-type]


@pytest.mark.parametrize("wrong", [{"robot": "7447"}, {"peers": [ROBOT, "lab2"]}])
def test_the_endpoints_of_a_router_are_checked_too(wrong: dict[str, object]) -> None:
    with pytest.raises(TopologyError, match="is no endpoint"):
        topology(router=True, **wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "name",
    [
        *("", "a*", "/a", "a/", "a//b", "a b", "a#", "$a", "a?"),
        *("a\nb", "a\n", "\x1b[31m", "\u202ea", "@a", "a" * 101),
    ],
)
def test_text_that_cannot_be_a_namespace_is_refused(name: str) -> None:
    with pytest.raises(TopologyError, match="namespace"):
        checked_namespace(name)
