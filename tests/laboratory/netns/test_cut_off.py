"""A host that is cut off from the robot's router delays nothing between the others."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from armadico.mesh.sockets import RUNTIME_VARIABLE
from armadico_tools.hosts.namespaces import Network
from tests.runtime_folder import fresh_folder

pytestmark = pytest.mark.live

ADDRESSES = {"robot": "10.77.3.1", "lab1": "10.77.3.2", "lab2": "10.77.3.3"}
ROUTER = f"tcp/{ADDRESSES['robot']}:7447"
MEMBER = Path(__file__).with_name("member.py")

MOST_S = 3.0
"""Closing a link that lingers would take 10 s, after a lease of 1 s."""


@pytest.fixture
def network() -> Iterator[Network]:
    with Network(ADDRESSES, seed=1) as made:
        yield made


def member(network: Network, host: str, role: str) -> subprocess.Popen[str]:
    """One member, on a host."""
    return network.hosts[host].popen(
        [sys.executable, str(MEMBER), role, ROUTER],
        env={RUNTIME_VARIABLE: fresh_folder()},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.mark.long
def test_others_receive_from_each_other_while_links_to_a_host_are_given_up(
    network: Network,
) -> None:
    member(network, "robot", "router")
    member(network, "lab2", "talker")
    listener = member(network, "robot", "listener")
    cut_off = [member(network, "lab1", "listener") for _ in range(3)]
    for each in (listener, *cut_off):
        assert each.stdout is not None
        assert each.stdout.readline() == "receives\n"
    network.change(lambda switch: switch.plug("lab1", False))
    assert listener.stdin is not None
    assert listener.stdout is not None
    listener.stdin.write("\n")
    listener.stdin.flush()
    assert float(listener.stdout.readline()) < MOST_S
