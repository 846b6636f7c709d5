"""Hosts, their cards and the switch between them, with real cycles."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from armadico.mesh.link_faults import LinkFaults
from armadico_tools.hosts.namespaces import Host, Network

ADDRESSES = {"left": "10.77.1.1", "right": "10.77.1.2"}
PORT = 5000
SOON = 20.0


@pytest.fixture
def network() -> Iterator[Network]:
    with Network(ADDRESSES, seed=1) as made:
        yield made


@pytest.fixture
def ends(network: Network) -> Iterator[dict[str, socket.socket]]:
    """A UDP socket on each host."""
    made = {name: network.hosts[name].inside(udp, ADDRESSES[name]) for name in ADDRESSES}
    # The first datagram waits for ARP, so it is sent here.
    exchanged(made)
    yield made
    for end in made.values():
        end.close()


def udp(address: str) -> socket.socket:
    end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end.bind((address, PORT))
    end.settimeout(SOON)
    return end


def exchanged(ends: dict[str, socket.socket]) -> None:
    """Something crosses from left to right and back."""
    for one, other in (("left", "right"), ("right", "left")):
        ends[one].sendto(b"hello", (ADDRESSES[other], PORT))
        assert ends[other].recv(64) == b"hello"


def counts(network: Network) -> tuple[int, int]:
    """How many cycles from left to right were led on, and lost."""
    count = network.change(lambda switch: switch.counts()[("left", "right")])
    return count.sent, count.lost


def test_hosts_reach_each_other_and_nothing_else(
    network: Network, ends: dict[str, socket.socket]
) -> None:
    exchanged(ends)
    elsewhere = ("192.0.2.1", PORT)
    with pytest.raises(OSError, match="unreachable"):
        ends["left"].sendto(b"hello", elsewhere)
    names = network.hosts["left"].inside(lambda: sorted(n for _, n in socket.if_nameindex()))
    assert "eth0" in names
    assert set(names) & {n for _, n in socket.if_nameindex()} <= {"lo", *names}


def test_a_cut_loses_what_is_sent_one_way_and_not_the_other(
    network: Network, ends: dict[str, socket.socket]
) -> None:
    network.change(lambda switch: switch.set([("left", "right")], LinkFaults(cut=True)))
    ends["left"].sendto(b"lost", (ADDRESSES["right"], PORT))
    ends["right"].sendto(b"there", (ADDRESSES["left"], PORT))
    assert ends["left"].recv(64) == b"there"
    network.change(lambda switch: switch.heal())
    ends["left"].sendto(b"whole", (ADDRESSES["right"], PORT))
    assert ends["right"].recv(64) == b"whole", "the one before was lost, not late"


def test_a_card_that_is_down_and_up_again_works(
    network: Network, ends: dict[str, socket.socket]
) -> None:
    network.hosts["right"].carrier(False)
    before = counts(network)
    ends["left"].sendto(b"lost", (ADDRESSES["right"], PORT))
    while counts(network) == before:  # the switch has it still, and would lead it on late
        pass
    network.hosts["right"].carrier(True)
    exchanged(ends)
    assert counts(network)[0] > before[0]


def test_a_host_takes_its_processes_with_it() -> None:
    with Host("left") as host:
        sleeper = host.popen([sys.executable, "-c", "import time; time.sleep(600)"])
        child = host.popen(["sh", "-c", "sleep 600 & wait"])
    assert sleeper.poll() is not None
    assert child.poll() is not None


def test_a_killed_process_leaves_neither_processes_nor_namespaces(tmp_path: Path) -> None:
    script = tmp_path / "maker.py"
    script.write_text(
        "import sys, time\n"
        "from armadico_tools.hosts.namespaces import Network\n"
        "network = Network({'left': '10.77.1.1', 'right': '10.77.1.2'})\n"
        "sleeper = [sys.executable, '-c', 'import time; time.sleep(600)']\n"
        "made = network.hosts['left'].popen(sleeper)\n"
        "print(made.pid, flush=True)\n"
        "time.sleep(600)\n"
    )
    before = named_namespaces()
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True) as maker:
        assert maker.stdout is not None
        process = psutil.Process(int(maker.stdout.readline()))
        maker.kill()
    _, alive = psutil.wait_procs([process], SOON)
    assert not alive
    assert named_namespaces() == before


def named_namespaces() -> list[str]:
    folder = Path("/run/netns")
    return sorted(path.name for path in folder.iterdir()) if folder.exists() else []
