"""The unkind controller, trap by trap."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from armadico.bridge.p2os.commands import SYNC0, SYNC1, SYNC2, Cmd, command
from armadico.bridge.p2os.profile import P2osRobot
from armadico.bridge.p2os.status import STATUS_TYPES
from armadico.bridge.simulator.pioneer import Pioneer
from armadico.bridge.simulator.plant import Site, seeded
from armadico.bridge.simulator.robots import Stage
from armadico.bridge.simulator.traps import KIND, Trap
from tests.robot.bridge.kit import IDEAL

if TYPE_CHECKING:
    from collections.abc import Callable

    from conftest import Bench

ZERO = command(Cmd.VEL, 0)


@pytest.fixture
def first_packet(make: Callable[..., Bench], profile: P2osRobot) -> Bench:
    return make(profile, frozenset({Trap.FIRST_PACKET}))


def replies(bench: Bench, *packets: bytes) -> list[int]:
    """The types of what comes back."""
    for packet in packets:
        bench.controller.receive(packet)
    return [payload[0] for payload in bench.run(0)]


def test_a_first_packet_that_is_no_sync_is_answered_and_sync0_never_again(
    first_packet: Bench,
) -> None:
    assert replies(first_packet, ZERO) == [Cmd.VEL]
    for _ in range(3):
        assert replies(first_packet, SYNC0) == []
        first_packet.run(1.0)


def test_until_the_client_goes(first_packet: Bench) -> None:
    replies(first_packet, ZERO)
    first_packet.controller.disconnect()
    assert replies(first_packet, SYNC0, SYNC1, SYNC2) == [0, 1, 2]


def test_or_closes(first_packet: Bench) -> None:
    replies(first_packet, ZERO, command(Cmd.CLOSE))
    assert replies(first_packet, SYNC0, SYNC1, SYNC2) == [0, 1, 2]


def test_a_client_that_sends_sync0_first_is_connected(first_packet: Bench) -> None:
    assert replies(first_packet, SYNC0, SYNC1, SYNC2, command(Cmd.OPEN)) == [0, 1, 2]
    assert first_packet.watched(0.2)


def test_sync2_alone_is_enough_and_names_the_robot(first_packet: Bench) -> None:
    first_packet.controller.receive(SYNC2)
    assert first_packet.run(0) == [b"\x02Armadico\0Pioneer\0p2dx\0"]


def test_open_may_set_the_odometry_to_zero(make: Callable[..., Bench], profile: P2osRobot) -> None:
    for traps, expected in ((KIND, 1.5), (frozenset({Trap.ODOMETRY}), 0.0)):
        bench = make(profile, traps)
        bench.plant.odometry = (1.5, 0.0, 0.0)
        bench.connect()
        assert bench.watched(0.1)[0].x_m == pytest.approx(expected, abs=1e-3)


def test_status_packets_are_those_of_arcos_or_of_p2os(
    make: Callable[..., Bench], profile: P2osRobot
) -> None:
    lengths = {}
    for traps in (KIND, frozenset({Trap.SHORT})):
        bench = make(profile, traps)
        bench.connect()
        bench.controller.receive(command(Cmd.SONAR, 0))
        lengths[traps] = [len(p) for p in bench.run(0.25) if p[0] in STATUS_TYPES][-1]
    assert lengths == {KIND: 30, frozenset({Trap.SHORT}): 25}


def test_a_sonar_may_be_a_single_ray(profile: P2osRobot) -> None:
    """Sonar 3 looks 10 degrees to the left; a post stands 8 degrees beside that, 2 m away."""
    mount = profile.sonar.sonars[3]
    heading = math.radians(mount.bearing_deg + 8)
    x, y = mount.x_m + 2 * math.cos(heading), mount.y_m + 2 * math.sin(heading)
    post = (x, y - 0.05, x, y + 0.05)
    kind, unkind = (
        Pioneer(profile, Stage(IDEAL, Site([post]), seeded(1), traps=traps)).plant.ping(3)
        for traps in (KIND, frozenset({Trap.RAYS}))
    )
    assert kind == pytest.approx(2.0, abs=0.1)
    assert unkind is None
