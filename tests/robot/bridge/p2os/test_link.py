"""Session and controller together, under a virtual clock."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest

from armadico.bridge.p2os.commands import SYNC0
from armadico.bridge.p2os.session import Connected, LinkLost, Reported, State

if TYPE_CHECKING:
    from conftest import Link


def kinds(events: list[object], kind: type) -> list[object]:
    return [event for event in events if isinstance(event, kind)]


def test_a_session_opens_and_cycles_come_ten_times_a_second(link: Link) -> None:
    events = link.let_pass(2.05)
    assert kinds(events, Connected) == [Connected("Armadico", "Pioneer", "p2dx")]
    reports = kinds(events, Reported)
    assert 18 <= len(reports) <= 20
    assert reports[-1].status.motors_enabled


def test_the_robot_goes_where_it_is_driven(link: Link) -> None:
    link.let_pass(0.5)
    for _ in range(30):
        link.session.drive(0.3, 0.0)
        link.let_pass(0.1)
    link.session.stop()
    pose = link.let_pass(2.0)[-1].pose
    assert pose.x == pytest.approx(link.plant.odometry[0], abs=0.002)
    assert pose.x == pytest.approx(0.3 * 3.0 - 0.15 + 0.075, abs=0.02)
    assert link.plant.v == 0


def test_the_pose_is_continuous_over_the_wrap_of_the_controllers(link: Link) -> None:
    link.let_pass(0.5)
    for _ in range(300):
        link.session.drive(1.0, 0.0)
        link.let_pass(0.1)
    assert link.events[-1].pose.x > 27.6
    assert link.events[-1].pose.x == pytest.approx(link.plant.odometry[0], abs=0.12)
    assert link.session.odometry.resets == 0


def drive_and_die(link: Link) -> None:
    """A client drives, dies without a word, and the watchdog stops the robot."""
    link.let_pass(0.5)
    link.session.drive(0.3, 0.0)
    link.let_pass(1.5)
    assert link.plant.v == pytest.approx(0.3)
    link.let_pass(4.0, client=False)
    assert link.plant.v == 0
    assert link.controller.is_open
    link.fastest = 0.0


def test_a_robot_left_open_lurches_at_the_next_clients_sync0(link: Link) -> None:
    drive_and_die(link)
    link.controller.receive(SYNC0)
    link.let_pass(1.5, client=False)
    assert link.fastest == pytest.approx(0.3)


@pytest.mark.parametrize("cut_off", [b"", b"\xfa\xfb\xc8", b"\xfa\xfb\x06\x0b\x3b"])
def test_with_close_first_it_does_not(link: Link, cut_off: bytes) -> None:
    link.let_pass(0.1)
    drive_and_die(link)
    link.controller.receive(cut_off)  # all that the dead client's last packet came to
    link.let_pass(0.5, client=False)
    link.new_session()
    events = link.let_pass(3.0)
    assert kinds(events, Connected)
    assert kinds(events, Reported)
    assert link.fastest == 0


def test_not_even_if_its_status_packets_do_not_arrive(link: Link) -> None:
    drive_and_die(link)
    advance = link.controller.advance
    link.controller.advance = lambda now: advance(now)[:0]  # type: ignore[method-assign]
    link.new_session()
    link.let_pass(5.0)
    assert link.fastest == 0
    link.controller.advance = advance  # type: ignore[method-assign]
    assert kinds(link.let_pass(5.0), Connected)
    assert link.fastest == 0


def test_after_a_hang_of_the_client_the_robot_does_not_lurch_either(link: Link) -> None:
    drive_and_die(link)
    late = link.now
    assert link.session.tick(late) == []
    link.let_pass(2.0)
    assert link.session.is_open
    assert link.fastest == 0


def test_a_dead_clients_session_is_taken_over_before_the_watchdog_too(link: Link) -> None:
    link.let_pass(0.5)
    link.session.drive(0.3, 0.0)
    link.let_pass(1.0)
    speed, link.fastest = link.plant.v, 0.0
    link.new_session()
    assert kinds(link.let_pass(3.0), Connected)
    assert link.fastest <= speed
    assert link.plant.v == 0


def test_a_link_that_is_cut_is_lost_and_comes_back_at_rest(link: Link) -> None:
    """Its pose is where the controller has counted to meanwhile, until its watchdog stopped it."""
    link.let_pass(0.5)
    link.session.drive(0.3, 0.0)
    before = link.let_pass(1.0)[-1].pose
    link.cut = True
    assert kinds(link.let_pass(5.0), LinkLost)
    assert link.plant.v == 0
    link.cut = False
    link.fastest = 0.0
    events = link.let_pass(3.0)
    assert kinds(events, Connected)
    assert link.fastest == 0
    first = kinds(events, Reported)[0]
    assert first.pose.x == pytest.approx(link.plant.odometry[0], abs=0.01)
    assert first.pose.x > before.x + 0.2


def test_a_link_without_a_robot_is_tried_for_ever(link: Link) -> None:
    link.cut = True
    link.let_pass(20.0)
    link.cut = False
    assert kinds(link.let_pass(3.0), Connected)


@pytest.mark.parametrize("seed", range(3))
def test_lost_and_mangled_bytes_delay_the_link_and_do_not_end_it(link: Link, seed: int) -> None:
    draws = random.Random(seed)
    advance = link.controller.advance

    def noisy(now: float) -> bytes:
        data = bytearray(advance(now))
        if data and draws.random() < 0.3:
            data[draws.randrange(len(data))] ^= 1 << draws.randrange(8)
        return bytes(data)

    link.controller.advance = noisy  # type: ignore[method-assign]
    link.let_pass(30.0)
    link.controller.advance = advance  # type: ignore[method-assign]
    link.let_pass(4.0)
    assert link.session.state is State.OPEN
    assert link.session.decoder.dropped > 0


def test_closing_leaves_the_robot_at_rest_and_ready_for_the_next(link: Link) -> None:
    link.let_pass(0.5)
    link.session.drive(0.3, 0.0)
    link.let_pass(1.0)
    link.session.close()
    link.let_pass(1.0)
    assert link.plant.v == 0
    assert not link.controller.is_open
    link.new_session()
    assert kinds(link.let_pass(1.0), Connected)


@pytest.mark.long(but=("0", "1"))
@pytest.mark.parametrize("seed", range(6))
def test_a_robot_at_rest_moves_for_a_drive_and_for_nothing_else(link: Link, seed: int) -> None:
    draws = random.Random(seed)
    moved = rested = 0
    for _ in range(60):
        link.fastest, resting = 0.0, link.plant.v == 0
        match draws.choice(["drive", "drive", "drive", "pulse", "die", "hang", "cut", "idle"]):
            case "drive":
                link.session.drive(draws.uniform(0.1, 0.5), draws.uniform(-1, 1))
                link.let_pass(draws.uniform(0.1, 1.0))
                moved += link.fastest > 0
                continue
            case "pulse":
                link.session.pulse()
            case "die":
                link.let_pass(draws.uniform(0, 4), client=False)
                link.new_session()
            case "hang":
                link.let_pass(draws.uniform(0, 4), client=False)
                link.session.tick(link.now)
                link.session.pulse()
            case "cut":
                link.cut = True
                link.let_pass(draws.uniform(0, 4))
                link.cut = False
        link.let_pass(draws.uniform(0.1, 3))
        rested += resting
        assert link.fastest == 0 or not resting
    assert moved > 5
    assert rested > 5
