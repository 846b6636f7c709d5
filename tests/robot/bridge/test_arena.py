"""Several robots in one world: they see each other, push each other, and come from one seed."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, pi
from typing import Any, cast

import pytest

from armadico.bridge.simulator.arena import Arena
from armadico.bridge.simulator.contact import Contact
from armadico.bridge.simulator.plant import STEP_S
from armadico.bridge.simulator.speed_loops import SpeedLoops

from .test_plant import AHEAD, FRONT, PROFILE, REAR, ROOM, plant

Pose = tuple[float, float, float]


class Driven:
    """A plant that is held at speeds, or has its motors off: what a Pioneer is to an arena."""

    def __init__(self, start: Pose, v: float | None = 0.0, w: float = 0.0) -> None:
        self.plant = plant(ROOM, start)
        self.order, self.now, self.bring_forward = (v, w), 0, None
        self._loops = SpeedLoops(PROFILE.speed_loop, PROFILE.motor.supply_v)

    def live(self, now: float) -> None:
        until = round(now / STEP_S)
        steps, self.now = until - self.now, until
        self.plant.run(steps, self._volts)

    def _volts(self, v: float, w: float) -> tuple[float, float]:
        wanted, turn = self.order
        if wanted is None:
            return 0.0, 0.0
        return self._loops.voltages(wanted, turn, v, w, STEP_S)


def together(*robots: Driven) -> Arena:
    return Arena(cast("Any", robots))


def apart(one: Driven, other: Driven) -> float:
    """From outline to outline, m; below 0 if they are in each other."""
    contacts: Sequence[Contact] = one.plant._outline.contacts(one.plant.pose)
    return min((c.gap for c in contacts if c.other is other.plant.body), default=inf)


def run(arena: Arena, robots: Sequence[Driven], seconds: float) -> float:
    """Let them live; the least way between any two."""
    least, now = inf, robots[0].now * STEP_S
    for k in range(1, round(seconds / 0.02) + 1):
        arena.advance(now + 0.02 * k)
        least = min(least, *(apart(a, b) for a in robots for b in robots if a is not b))
    return least


def test_a_robot_detects_the_other_at_its_distance() -> None:
    one, other = Driven((0.0, 0.0, 0.0)), Driven((2.0, 0.0, pi))
    together(one, other)
    alone = plant(ROOM).ping(AHEAD)
    distance = one.plant.ping(AHEAD)
    assert distance is not None
    assert alone is not None
    assert distance < 2.0 - 2 * FRONT + 0.3 < alone
    assert one.plant.clearance() == pytest.approx(2.0 - 2 * FRONT, abs=1e-6)


def test_it_detects_where_the_other_has_gone() -> None:
    one, other = Driven((0.0, 0.0, 0.0)), Driven((1.0, 0.0, 0.0), v=0.4)
    arena = together(one, other)
    before = one.plant.ping(AHEAD)
    arena.advance(3.0)
    after = one.plant.ping(AHEAD)
    assert before is not None
    assert after is not None
    assert after > before + 0.8


def test_a_robot_that_drives_into_another_pushes_it_and_is_to_blame() -> None:
    one, other = Driven((-1.0, 0.0, 0.0), v=0.3), Driven((0.0, 0.0, 0.0), v=None)
    least = run(together(one, other), (one, other), 6.0)
    assert other.plant.pose[0] > 0.2, "it was pushed ahead"
    assert one.plant.pose[0] < other.plant.pose[0] - FRONT - REAR + 0.002
    assert least > -0.002, "and never entered"
    assert (one.plant.touches.collisions, one.plant.touches.bumps) == (1, 0)
    assert (other.plant.touches.collisions, other.plant.touches.bumps) == (0, 1)


def test_head_on_both_stop_and_both_are_to_blame() -> None:
    one, other = Driven((-1.0, 0.0, 0.0), v=0.3), Driven((1.0, 0.0, pi), v=0.3)
    least = run(together(one, other), (one, other), 8.0)
    assert least > -0.002
    assert abs(one.plant.pose[0] + other.plant.pose[0]) < 0.05, "neither gives way"
    assert one.plant.touches.collisions == other.plant.touches.collisions == 1


def test_momentum_goes_over_when_one_hits_another() -> None:
    one, other = Driven((-0.45, 0.0, 0.0), v=0.6), Driven((0.0, 0.0, 0.0), v=None)
    one.plant._dynamics.v = 0.6
    arena = together(one, other)
    before = one.plant._dynamics.inertia()[0] * 0.6
    momentum = 0.0
    for k in range(1, 20):
        arena.advance(k * STEP_S)
        if other.plant.speeds[0] > 0.05:
            momentum = sum(r.plant._dynamics.inertia()[0] * r.plant.speeds[0] for r in (one, other))
            break
    # Brakes, friction and what is left of the gap take their share within the step.
    assert 0.5 * before < momentum < before
    arena.advance(0.2)
    paces = [robot.plant.speeds[0] for robot in (one, other)]
    assert paces[1] > 0.0
    assert paces[0] == pytest.approx(paces[1], abs=0.02), "from then on as one"


def test_one_that_is_hit_off_its_middle_is_turned() -> None:
    one, other = Driven((0.0, -1.0, pi / 2), v=0.4), Driven((0.15, 0.0, 0.0), v=None)
    run(together(one, other), (one, other), 5.0)
    assert abs(other.plant.pose[2]) > 0.1


def test_one_by_a_wall_is_pushed_no_farther_than_the_wall() -> None:
    one, other = Driven((0.0, 0.0, 0.0), v=0.4), Driven((4.0 - FRONT - 0.1, 0.0, 0.0), v=None)
    least = run(together(one, other), (one, other), 14.0)
    assert other.plant.pose[0] < 4.0 - FRONT + 0.002
    assert least > -0.004


def test_results_do_not_depend_on_when_they_are_read() -> None:
    def driven(times: Sequence[float]) -> list[Pose]:
        robots = (Driven((-1.5, 0.0, 0.0), v=0.4), Driven((1.0, 0.3, pi), v=0.3, w=0.1))
        arena = together(*robots)
        for now in times:
            arena.advance(now)
        return [robot.plant.pose for robot in robots]

    assert driven([6.0]) == driven([0.013, 1.234, 2.5, 3.003, 5.99, 6.0])


def test_alone_in_an_arena_is_alone() -> None:
    one, free = Driven((0.0, 0.0, 0.3), v=0.4, w=0.2), Driven((0.0, 0.0, 0.3), v=0.4, w=0.2)
    together(one).advance(9.0)
    free.live(9.0)
    assert one.plant.pose == free.plant.pose


def test_robots_may_not_start_inside_each_other() -> None:
    with pytest.raises(ValueError, match="cannot start at 0, 0"):
        together(Driven((0.0, 0.0, 0.0)), Driven((0.2, 0.0, 0.0)))
