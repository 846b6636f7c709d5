"""The driver against its simulator, and against bytes that no Create 2 sends."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest
from armadico_create2 import driver
from armadico_create2.driver import PACKETS, Decoder, Driver, encode
from armadico_create2.kind import CREATE2, Create2
from msgspec.structs import replace

from armadico.bridge.kind import simulated
from armadico.bridge.session import Connected, Event, LinkLost, Reported, Unanswered
from armadico.bridge.simulator.plant import seeded
from armadico.config.profile import load_profile
from armadico.config.scenarios import ideal, load_scenario

STEP_S = 0.02
SAFE = dict.fromkeys(PACKETS, 0) | {22: 15000, 35: driver.SAFE_MODE}


@pytest.fixture
def profile() -> Create2:
    found = load_profile("create2")
    assert isinstance(found, Create2)
    return found


class Bench:
    """The driver on the simulated robot's line, in an empty world."""

    def __init__(self, profile: Create2) -> None:
        scenario = replace(ideal(load_scenario("sc1")), robot="create2")
        self.robot = simulated(scenario, seeded(1))
        self.now = 0.0
        session = CREATE2.session(profile, self.now, (0.0, 0.0))
        assert isinstance(session, Driver)
        self.driver = session
        self.events: list[Event] = []

    def run(self, seconds: float, *, answers: bool = True) -> Reported:
        """Let time pass; the newest report."""
        for _ in range(round(seconds / STEP_S)):
            self.now += STEP_S
            if answers:
                self.robot.receive(self.driver.outgoing(), self.now)
                self.events += self.driver.receive(self.robot.advance(self.now), self.now)
            self.events += self.driver.tick(self.now)
        return next(e for e in reversed(self.events) if isinstance(e, Reported))


@pytest.fixture
def bench(profile: Create2) -> Bench:
    return Bench(profile)


def test_it_opens_and_reports_each_cycle(bench: Bench, profile: Create2) -> None:
    report = bench.run(2.0)
    reports = [e for e in bench.events if isinstance(e, Reported)]
    assert isinstance(bench.events[0], Connected)
    assert len(reports) == pytest.approx(2.0 / profile.cycle_s, abs=2)
    assert report.motors
    assert report.battery_v == pytest.approx(16.0, abs=0.5)
    assert bench.driver.line.dropped == 0


def test_it_drives_as_it_is_told_and_counts_its_way(bench: Bench) -> None:
    bench.run(0.5)
    bench.driver.drive(0.2, 0.0)
    bench.run(5.0)
    bench.driver.stop()
    report = bench.run(1.0)
    assert (report.v, report.w) == (0.0, 0.0)
    true = bench.robot.truth()
    start = load_scenario("sc1").start
    assert report.pose.x == pytest.approx(true.x - start[0], abs=0.01)
    assert 0.8 < report.pose.x < 1.1
    bench.driver.drive(0.0, 1.0)
    assert bench.run(3.0).w == pytest.approx(1.0, abs=0.05)


def test_the_faster_wheel_bounds_both() -> None:
    assert driver.drive_direct(0.2, 0.0, 0.1175) == bytes.fromhex("91 00c8 00c8")
    assert driver.drive_direct(0.5, 1.0, 0.1) == bytes.fromhex("91 01f4 014d")


def test_a_wall_is_seen_by_the_light_bumpers(bench: Bench) -> None:
    assert {distance for _, distance in bench.run(0.5).echoes} == {0.2}
    x, y, _ = bench.robot.plant.pose
    bench.robot.plant.add_walls([(x + 0.28, y - 1.0, x + 0.28, y + 1.0)])
    near = dict(bench.run(0.5).echoes)
    assert near[2] == pytest.approx(0.114, abs=0.01)
    assert near[0] == 0.2, "it looks aside"


def frames(driver: Driver, now: float, *values: dict[int, int]) -> list[Reported]:
    """What a cycle of frames is reported as."""
    data = b"".join(encode(each) for each in values)
    return [e for e in driver.receive(data, now) if isinstance(e, Reported)]


def test_a_bump_of_one_frame_and_a_cliff_count_in_their_cycle(profile: Create2) -> None:
    one = Driver(profile, 0.0)
    (report,) = frames(one, 0.1, SAFE, SAFE | {7: 1}, *[SAFE] * 5)
    assert report.front_bumpers == 1
    (report,) = frames(one, 0.2, SAFE | {10: 1}, *[SAFE] * 6)
    assert report.front_bumpers == 4
    (report,) = frames(one, 0.3, *[SAFE] * 7)
    assert report.front_bumpers == 0


def test_a_wheel_that_drops_is_a_robot_that_is_lifted(profile: Create2) -> None:
    (report,) = frames(Driver(profile, 0.0), 0.1, *[SAFE | {7: 8}] * 7)
    assert report.lifted


def test_a_person_who_ends_safe_mode_stops_it_and_a_cliff_that_does_is_no_person(
    profile: Create2,
) -> None:
    passive = SAFE | {35: driver.PASSIVE_MODE}
    one = Driver(profile, 0.0)
    frames(one, 0.1, *[SAFE] * 7)
    (report,) = frames(one, 0.2, *[passive | {9: 1}] * 7)
    assert (report.stop_button, report.motors) == (False, False)
    assert bytes((driver.SAFE,)) in one.outgoing(), "it is asked for again"
    frames(one, 0.3, *[SAFE] * 7)
    (report,) = frames(one, 0.4, *[passive] * 7)
    assert report.stop_button


def test_counts_that_wrap_are_a_way_and_those_of_a_robot_that_was_off_are_none(
    profile: Create2,
) -> None:
    one = Driver(profile, 0.0)
    frames(one, 0.1, *[SAFE | {43: 32760, 44: 32760}] * 7)
    (report,) = frames(one, 0.2, *[SAFE | {43: -32736, 44: -32736}] * 7)
    assert report.pose.x == pytest.approx(40 / 2249.4)
    (report,) = frames(one, 0.3, *[SAFE] * 7)
    assert report.pose.x == pytest.approx(40 / 2249.4)
    assert one.line.resets == 1


def test_of_what_waited_while_the_owner_hung_the_newest_cycle_counts(profile: Create2) -> None:
    one = Driver(profile, 0.0)
    assert len(frames(one, 0.5, *[SAFE] * 70)) == 1
    assert one.line.surplus == 9


def test_silence_loses_the_link_and_it_is_opened_again(bench: Bench) -> None:
    bench.run(0.5)
    bench.run(2.5, answers=False)
    kinds = [type(event) for event in bench.events]
    assert kinds.index(LinkLost) < kinds.index(Unanswered)
    assert not bench.driver.is_open
    bench.run(0.5)
    assert bench.driver.is_open


def test_a_driver_that_ends_leaves_the_robot_at_rest(bench: Bench) -> None:
    bench.run(0.5)
    bench.driver.drive(0.2, 0.0)
    bench.run(1.0)
    bench.driver.close()
    bench.robot.receive(bench.driver.outgoing(), bench.now)
    bench.robot.advance(bench.now + 1.0)
    assert bench.robot.truth().v == pytest.approx(0.0, abs=1e-3)


def damaged(chance: random.Random) -> Iterable[bytes]:
    for _ in range(300):
        data = bytearray(b"".join(encode(SAFE) for _ in range(3)))
        for _ in range(chance.randrange(6)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        yield bytes(data[chance.randrange(8) :])


def test_damaged_frames_are_dropped_and_good_ones_that_follow_are_found() -> None:
    decoder = Decoder()
    for data in damaged(random.Random(1)):
        assert all(set(values) == set(PACKETS) for values in decoder.feed(data))
    assert decoder.mangled > 0
    assert decoder.feed(3 * encode(SAFE))[-1] == SAFE
