"""The robot agent and the simulator come back: no lurch, the same cycles, the same driver."""

from __future__ import annotations

import pytest
from msgspec import structs

from armadico.bridge.p2os.commands import Cmd
from tests.robot.society import ballots_never_go_down
from tests.whole.live.conftest import Start
from tests.whole.live.society import LINE
from tests.whole.live.speeds import moves

pytestmark = pytest.mark.live


def test_a_new_robot_agent_closes_what_was_left_open_and_the_same_holder_drives_on(
    start: Start,
) -> None:
    """With nobody to outbid it, it must go on from the largest ballot that it knows of itself."""
    society = start(structs.replace(LINE, agents=("encoder", "sonar", "goto", "interface")))
    holder, epoch = society.holder, society.state.cycle.epoch
    society.kill("robot")
    society.truths_pass(5)
    society.until(society.at_rest, "the controller's watchdog stops the wheels")
    mark = len(society.tap.packets)
    society.restart("robot")
    society.until(lambda: society.state.cycle.epoch != epoch, "a new epoch")
    society.drives_on()
    said = society.tap.commands(mark)
    assert said[0].number == Cmd.CLOSE
    started = next(i for i, command in enumerate(said) if moves(command))
    assert Cmd.OPEN in {command.number for command in said[:started]}
    assert society.holder == holder
    society.nobody_else_died()
    ballots_never_go_down(society.acks)


@pytest.mark.long
def test_a_simulator_that_comes_back_is_driven_on(start: Start) -> None:
    society = start()
    epoch = society.state.cycle.epoch
    society.kill("simulator")
    society.until(lambda: any("is gone" in text for text in society.logs), "the port is gone")
    society.launcher.start_simulator(society.tap.port)
    number = society.state.cycle.number
    society.until(lambda: society.state.cycle.number > number, "cycles again")
    society.drives_on()
    assert society.state.cycle.epoch == epoch, "the robot agent is the same"
    society.nobody_else_died()
