"""How a process joins the mesh: where a router listens, and what a client connects to."""

from __future__ import annotations

import pytest

from armadico.mesh.topology import TopologyError, checked_namespace, place_of, topology

ROBOT = "tcp/10.0.0.1:7447"


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
    ("endpoint", "place"),
    [
        ("tcp/[fe80::1]:7447", ("fe80::1", 7447)),
        ("tls/lab1:7447?rel=0#iface=eth0", ("lab1", 7447)),
    ],
)
def test_the_place_of_an_endpoint_is_without_its_settings(
    endpoint: str, place: tuple[str, int]
) -> None:
    assert place_of(endpoint) == place


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
