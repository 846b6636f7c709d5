"""A holder that is fresh, fenced and wrong: the robot agent holds it, whatever it commands."""

from __future__ import annotations

from random import Random
from typing import Any, ClassVar

import pytest
from msgspec.structs import replace

from armadico.config.profile import load_profile
from armadico.config.scenarios import Scenario, ideal
from armadico.core.agent import Agent
from armadico.core.exchange import Bid
from armadico.core.messages import RobotState
from armadico.core.resources import WHEELS, Resource
from armadico.launch.society import Options
from armadico.launch.virtual import Rehearsal
from armadico.mobile.messages import Truth
from tests.driven import Driven

ALONE = Scenario(
    name="walls", world="sc3", start=(1.2, 1.4, 0.0), goal=None, agents=("robot", "interface")
)
LASTS_S = 40.0


class Liar(Agent):
    """Drives on, whatever is in the way."""

    name = "liar"
    reacts_to = RobotState
    competes_for: ClassVar[tuple[Resource, ...]] = (WHEELS,)

    def bid(self, message: Any) -> Bid:
        return Bid(0.99, self.wanted())

    def wanted(self) -> tuple[float, float]:
        return 0.2, 0.05


class Hostile(Liar):
    """Commands anything that the robot could do, each for a while."""

    name = "hostile"
    top: ClassVar[tuple[float, float]] = (0.0, 0.0)
    _random: ClassVar[Random] = Random(1)
    _until, _now = -1.0, (0.0, 0.0)

    def wanted(self) -> tuple[float, float]:
        if self.now > self._until:
            draw, (v, w) = self._random.uniform, self.top
            self._until = self.now + draw(0.3, 3.0)
            self._now = draw(-0.3 * v, v), draw(-w, w)
        return self._now


@pytest.mark.long(but=("Liar-pioneer-2dx", "Hostile-jackal"))
@pytest.mark.parametrize("robot", ["pioneer-2dx", "jackal", "turtlebot4"])
@pytest.mark.parametrize("holder", [Liar, Hostile])
def test_it_touches_nothing_that_the_sensors_could_have_shown(
    holder: type[Liar], robot: str
) -> None:
    if robot == "jackal":
        pytest.importorskip("armadico.bridge.ros2")
    limits = load_profile(robot).limits
    Hostile.top, Hostile._random = (limits.v_max, limits.w_max), Random(1)
    scenario = replace(ideal(ALONE), robot=robot)
    run = Driven(Rehearsal(scenario, Options(seed=1)), RobotState, Truth).begin()
    run.run.add(holder)
    run.let_pass(LASTS_S)
    last = run.of(Truth)[-1]
    assert last.collisions == 0, f"at {last.x:.2f}, {last.y:.2f}"
    moved = [state for state in run.of(RobotState) if state.admitted.v]
    assert moved, "it is let drive where that is free"
    assert any(state.capped for state in run.of(RobotState))
