"""`armadico top` shows why the robot stands."""

from __future__ import annotations

from msgspec.structs import replace
from rich.console import Console

from armadico.core.messages import Cycle, RobotState, Stop
from armadico.observe.view import View
from armadico.watch.commands import top

WELL = RobotState(Cycle(1, 1), 0, 0, 0, 0, 0, 12, motors=True, stalled=False)


def test_top_says_why_the_robot_stands() -> None:
    view = View()
    stop = Stop(1, stopped=True, by="anna")
    view.token("robot-1", there=True, t=0.0)
    view.update("robot/state", replace(WELL, stop=stop), 0.0)
    snapshot = top.Snapshots(view, "robot1").at(0.1)
    assert snapshot["standing"]["cause"]["who"] == "anna"
    console = Console(width=120)
    with console.capture() as shown:
        console.print(top.tables(snapshot))
    assert "It is stopped by anna." in shown.get()
