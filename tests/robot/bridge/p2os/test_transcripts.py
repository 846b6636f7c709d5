"""Sessions recorded between an ARIA client and another simulator, replayed to both of our sides."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from armadico.bridge.p2os.commands import Cmd, decode_command
from armadico.bridge.p2os.configuration import decode_texts
from armadico.bridge.p2os.odometry import Odometry
from armadico.bridge.p2os.packets import Decoder
from armadico.bridge.p2os.status import Status, decode_status
from tests.robot.bridge.units import decode_configuration

if TYPE_CHECKING:
    from conftest import Link

    from armadico.bridge.p2os.profile import P2osRobot

FOLDER = Path(__file__).parent / "transcripts"
NAMES = ("01_simpleConnect", "02_simpleMotionCommands", "10_serial_pty")
Rows = list[tuple[float, bytes]]


def rows(name: str, direction: str) -> Rows:
    """What was read, with the seconds since the connection."""
    data = (FOLDER / f"{name}.{direction}.bin").read_bytes()
    lines = map(json.loads, (FOLDER / f"{name}.idx.jsonl").read_text().splitlines())
    mine = [line for line in lines if line.get("dir") == direction and "len" in line]
    return [(line["t"], data[line["off"] : line["off"] + line["len"]]) for line in mine]


def answers(link: Link, name: str) -> list[tuple[float, bytes]]:
    """Our controller's packets to the recorded client, at the recorded times."""
    decoder, got, sent = Decoder(), [], rows(name, "c2s")
    end = sent[-1][0] + 1
    for time, data in [*sent, (100.0, b"")]:
        while link.now < min(time, end):
            link.now = round(link.now + 0.01, 6)
            got += [(link.now, p) for p in decoder.feed(link.controller.advance(link.now))]
        link.controller.receive(data)
    return got


@pytest.mark.parametrize("name", NAMES)
def test_the_recorded_client_gets_what_it_needs(link: Link, name: str) -> None:
    got = answers(link, name)
    payloads = [payload for _, payload in got]
    assert payloads[:2] == [b"\x00", b"\x01"]
    assert decode_texts(payloads[2][1:], 3) == ("Armadico", "Pioneer", "p2dx")
    configuration = decode_configuration(payloads[3])
    assert configuration.serial_number == "SIM"
    assert configuration.auto_baud == 0
    assert all(payload[0] in {0x32, 0x33} for payload in payloads[4:])
    recorded = b"".join(data for _, data in rows(name, "s2c"))
    theirs = [p for p in Decoder().feed(recorded) if p[0] == 0x32]
    assert abs(len(payloads[4:]) - len(theirs)) <= 2


@pytest.mark.parametrize("name", NAMES)
def test_the_recorded_goodbye_leaves_the_robot_closed(link: Link, name: str) -> None:
    answers(link, name)
    assert not link.controller.is_open
    assert link.plant.v == 0


def test_the_recorded_drive_moves_our_robot_as_it_moved_theirs(
    link: Link, profile: P2osRobot
) -> None:
    name = "02_simpleMotionCommands"
    ours = [p for _, p in answers(link, name) if p[0] in {0x32, 0x33}]
    theirs = [p for p in statuses(name, Decoder()) if p[0] == 0x32]
    our_pose, their_pose = (travelled(packets, profile) for packets in (ours, theirs))
    assert their_pose[0] > 0.5
    assert our_pose == pytest.approx(their_pose, abs=0.1)


@pytest.mark.parametrize("name", NAMES)
def test_the_recorded_robot_is_understood(name: str, profile: P2osRobot) -> None:
    decoder = Decoder()
    payloads = statuses(name, decoder)
    assert [payload[0] for payload in payloads[:3]] == [0, 1, 2]
    (configuration,) = (payload for payload in payloads if payload[0] == 0x20)
    assert decoder.dropped == decoder.pending == 0
    assert decode_configuration(configuration).w_max == pytest.approx(2.618, abs=0.001)
    for payload in (payload for payload in payloads if payload[0] == 0x32):
        status = decode_status(payload, profile.p2os)
        assert status.battery_v == pytest.approx(13.0)
        assert [index for index, _ in status.echoes] == list(range(16))
        assert all(0.1 <= range_m < 5.001 for _, range_m in status.echoes)


def test_the_radio_modems_greeting_costs_nothing() -> None:
    decoder = Decoder()
    stream = b"".join(data for _, data in rows("10_serial_pty", "c2s"))
    numbers = [decode_command(payload).number for payload in decoder.feed(stream)]
    assert numbers[:5] == [0, 1, 2, Cmd.OPEN, Cmd.CONFIG]
    assert Cmd.HOSTBAUD in numbers
    assert decoder.dropped == len(b"WMS2\r")


def statuses(name: str, decoder: Decoder) -> list[bytes]:
    return decoder.feed(b"".join(data for _, data in rows(name, "s2c")))


def travelled(packets: list[bytes], profile: P2osRobot) -> tuple[float, float, float]:
    odometry = Odometry(profile.p2os)
    for turn, payload in enumerate(packets):
        status: Status = decode_status(payload, profile.p2os)
        pose = odometry.update(status, turn * 0.1)
    return pose.x, pose.y, pose.theta
