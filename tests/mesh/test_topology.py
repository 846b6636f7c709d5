"""Where a process listens and connects: nothing leaves this machine unless it is asked for."""

from __future__ import annotations

import pytest

from armadico.mesh.topology import (
    ENDPOINTS_VARIABLE,
    WELL_KNOWN,
    TopologyError,
    checked_namespace,
    topology,
)

REMOTE = "tcp/192.168.1.5:7450"
HERE = ("tcp/10.0.0.1:7450", "tcp/10.0.0.1:7451")
THERE = ("tcp/10.0.0.2:7450",)


def test_without_configuration_it_binds_the_first_free_loopback_port_and_connects_to_all() -> None:
    where = topology(environ={})
    assert where.attempts == (*((e,) for e in WELL_KNOWN), ("tcp/127.0.0.1:0",))
    assert where.connect == WELL_KNOWN
    assert all(e.startswith("tcp/127.0.0.1:") for attempt in where.attempts for e in attempt)


def test_a_tool_that_is_soon_gone_takes_no_well_known_port() -> None:
    where = topology(passing=True, environ={})
    assert where.attempts == (("tcp/127.0.0.1:0",),)
    assert where.connect == WELL_KNOWN


def test_the_environment_replaces_the_well_known_ones() -> None:
    where = topology(environ={ENDPOINTS_VARIABLE: "tcp/127.0.0.1:9, tcp/127.0.0.1:10"})
    assert where.connect == ("tcp/127.0.0.1:9", "tcp/127.0.0.1:10")


def test_the_host_table_wins_over_the_environment() -> None:
    where = topology(
        host_endpoints=HERE,
        all_endpoints=HERE + THERE,
        environ={ENDPOINTS_VARIABLE: "tcp/127.0.0.1:9"},
    )
    assert where.attempts == ((HERE[0],), (HERE[1],), ("tcp/10.0.0.1:0",))
    assert where.connect == HERE + THERE


def test_the_command_line_wins_over_all() -> None:
    where = topology(
        listen=["tcp/0.0.0.0:9"], connect=[REMOTE], host_endpoints=HERE, all_endpoints=HERE
    )
    assert where.attempts == (("tcp/0.0.0.0:9",),)
    assert where.connect == (REMOTE,)


@pytest.mark.parametrize(
    ("seed", "listens"),
    [
        (REMOTE, "tcp/0.0.0.0:0"),
        ("tls/robot.local:7450", "tls/0.0.0.0:0"),
        ("tcp/127.0.0.1:8000", "tcp/127.0.0.1:0"),
        ("tcp/localhost:8000", "tcp/localhost:0"),
    ],
)
def test_who_connects_elsewhere_can_be_reached_from_there_and_no_further(
    seed: str, listens: str
) -> None:
    assert topology(connect=[seed], environ={}).attempts == ((listens,),)


@pytest.mark.parametrize(
    "text",
    [
        *("", "7450", "tcp/", "tcp/host", "tcp/host:", "host:7450"),
        *("tcp/host:65536", "tcp/host:99999999999", "tcp/host:\u00b9"),
    ],
)
def test_what_is_no_endpoint_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(TopologyError, match=r"tcp/192\.168\.1\.5:7450"):
        topology(connect=[text])


@pytest.mark.parametrize(
    "name",
    [
        *("", "a*", "/a", "a/", "a//b", "a b", "a#", "$a", "a?"),
        *("a\nb", "a\n", "\x1b[31m", "\u202ea", "@a", "a" * 101),
    ],
)
def test_what_cannot_be_a_namespace_is_refused(name: str) -> None:
    with pytest.raises(TopologyError, match="namespace"):
        checked_namespace(name)


def test_a_namespace_may_have_parts() -> None:
    assert checked_namespace("lab/r-1") == "lab/r-1"
