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


def test_the_last_message_of_a_silent_robot_is_not_shown_as_its_present_state() -> None:
    view = View()
    view.token("robot-1", there=True, t=0.0)
    view.update("robot/state", replace(WELL, v=0.3), 0.0)
    snapshots = top.Snapshots(view, "robot1")
    assert snapshots.at(0.1)["connected"]
    snapshot = snapshots.at(12.0)
    assert (snapshot["connected"], snapshot["silent_s"]) == (False, 12.0)
    console = Console(width=200)
    with console.capture() as shown:
        console.print(top.tables(snapshot))
    assert "no message from the robot for 12.0 s; before that, 0.30 m/s" in shown.get()
