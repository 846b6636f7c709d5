"""Run, list, show and cancel missions of several tasks; list alarms."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from armadico.cli import options, run
from armadico.cli.additions import Addition, added
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import Command, argument, between, flag, group, option
from armadico.cli.run_options import Drive, choose

if TYPE_CHECKING:
    from armadico.agents.missions.messages import Board, BoardMission
    from armadico.agents.missions.mission_file import Mission
    from armadico.launch.client import Client

FIND_S: Final = 3.0  # the timeout for the board, which is published each second

ANSWER_S: Final = 10.0  # the timeout for the interface agent's reply to a cancellation

EXAMPLES: Final = """\
  armadico mission run surveillance --virtual --seed 7   in one process, repeatable
  armadico mission run surveillance                      processes on this machine
  armadico mission run my.toml house --virtual           a mission of yours, in that scenario
  armadico mission run rounds --attach --priority 0.9    the society is up: armadico up
  armadico mission list                                  those that come with Armadico
  armadico mission status                                those of a running society
  armadico mission alarms                                active alarms, and whether checked
  armadico mission cancel surveillance                   or by its number, or --all
  armadico mission log surveillance                      the result of each step
"""

RUN_EXAMPLES: Final = """\
  armadico mission run surveillance --virtual --seed 7
  armadico mission run surveillance --virtual --runs 5 --json
  armadico mission run my.toml --world office.map --start 1 1.5 0 --virtual
  armadico mission run rounds --attach --priority 0.9
"""

WHAT: Final = ("run", "list", "status", "alarms", "cancel", "log")


@dataclass(frozen=True, kw_only=True)
class Options:
    what: str = argument("what to do", choices=WHAT)
    name: str | None = argument("cancel, log: which mission, by name or number", nargs="?")
    all: bool = flag("cancel: all of them, and the goal that is driven")
    json: bool = flag("one JSON object, or list, on stdout")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


@dataclass(frozen=True, kw_only=True)
class RunOptions(Drive):
    mission: str = argument("a shipped mission's name, or a TOML file")
    priority: float | None = option(
        "0 to 1, instead of the mission's own", metavar="P", must=between(0, 1)
    )
    additions: tuple[Addition, ...] = added("mission run")


def main(argv: Sequence[str]) -> int:
    """Run the command; `run` returns 0 only if the mission succeeded without a collision."""
    return RUN(argv[1:]) if argv[:1] == ["run"] else COMMAND(argv)


def _show(args: Options) -> int:
    shown: dict[str, Callable[[Options], int]] = {
        "list": _list,
        "status": _missions,
        "alarms": _alarms,
        "cancel": _cancel,
        "log": _missions,
    }
    return shown[args.what](args)


# A run --------------------------------------------------------------------------------------------


def _run(args: RunOptions) -> int:
    from armadico.agents.missions.mission_file import load_mission
    from armadico.config.shipped import find

    mission, found = load_mission(args.mission), str(find("missions", args.mission).resolve())
    if args.scenario is None and args.world is None:
        if mission.scenario is None:
            raise UsageError(
                f"{mission.name} names no scenario: give one (armadico mission run"
                f" {args.mission} house), or --world MAP --start X Y DEG"
            )
        args = replace(args, scenario=mission.scenario)
    with run.answering(args):
        scenario, chosen = choose(args, somewhere=False, mission=found)
        return run.drive(args, scenario, chosen)


# Shipped missions ---------------------------------------------------------------------------------


def _list(args: Options) -> int:
    from armadico.agents.missions.mission_file import load_mission
    from armadico.config.shipped import names

    found = [load_mission(name) for name in names("missions")]
    if args.json:
        print(json.dumps([_plain(mission) for mission in found]))
        return 0
    for mission in found:
        where = f" ({mission.scenario})" if mission.scenario else ""
        print(f"{mission.name:16} {mission.priority:.1f}  {mission.title}{where}")
    return 0


def _plain(mission: Mission) -> dict[str, object]:
    return {
        "name": mission.name,
        "title": mission.title,
        "priority": mission.priority,
        "scenario": mission.scenario,
        "steps": [str(step) for step in mission.procedures[""].steps],
    }


# Missions of a running society --------------------------------------------------------------------


def _missions(args: Options) -> int:
    """`status`: the missions on the board, and the alarms; `log`: with the results of steps."""
    with args.mesh.client() as client:
        board = _board(client)
    missions: Sequence[BoardMission] = () if board is None else board.missions
    log = args.what == "log"
    if log and args.name is not None:
        missions = _chosen(missions, args.name)
    if args.json:
        print(json.dumps([plain(mission) for mission in missions]))
        return 0
    for mission in missions:
        print(in_a_line(mission))
        for result in mission.course.results if log else ():
            print(f"  {result.at:8.1f} s  {options.shown(str(result))}")
    if board is not None and board.alarms and not log:
        print(options.shown(f"alarms: {', '.join(board.alarms)}"))
    if not missions:
        print("no missions")
    return 0


def _alarms(args: Options) -> int:
    """List the known alarms. `status` has a list of missions only."""
    with args.mesh.client() as client:
        board = _board(client)
    rooms = () if board is None else board.alarms
    checked = {room: board is not None and room not in board.unchecked for room in rooms}
    if args.json:
        print(json.dumps([{"room": room, "checked": seen} for room, seen in checked.items()]))
        return 0
    for room, seen in checked.items():
        print(options.shown(f"{room:16} {'checked' if seen else 'not checked yet'}"))
    if not checked:
        print("no alarms")
    return 0


def _cancel(args: Options) -> int:
    if (args.name is None) == (not args.all):
        raise UsageError("cancel: name one mission (by name or number), or give --all")
    with args.mesh.client() as client:
        if args.name is None:
            numbers = cancel_all(client)
        else:
            board = _board(client)
            chosen = _chosen(() if board is None else board.missions, args.name)
            numbers = [mission.mission for mission in chosen if not mission.over]
            if not numbers:
                raise FailedError(f"{args.name}: the mission is over already")
            for number in numbers:
                if refusal := _refusal(client, number):
                    raise FailedError(refusal)
    print(json.dumps({"cancelled": numbers}) if args.json else "cancelled")
    return 0


def cancel_all(client: Client) -> list[int]:
    """Cancel all missions, and the goal that is driven, which is on no board; return the numbers.

    0 stands for the missions. Raises FailedError if nothing was cancelled, or not all of it.
    """
    from armadico.agents.interface.interface import NO_MISSION_PLANNING
    from armadico.agents.interface.messages import MissionWithdrawal
    from armadico.core.services import service_of
    from armadico.mobile.messages import MissionState, MissionStatus

    key = service_of(MissionWithdrawal).key
    cards = client.cards().values()  # an agent that hangs sends none, and is soon taken as gone
    plans = any(card is None or key in card.provides for card in cards)
    refusal = _refusal(client, 0)
    status = client.latest(MissionStatus, FIND_S)
    drives = status is not None and status.state is MissionState.DRIVING
    goal = [status.mission] if status is not None and drives else []
    if goal and _refusal(client, goal[0]):
        goal = []  # it is a mission's: of the board, or of another agent
    if not refusal:
        return [0, *goal]
    if not goal:
        by = (status and options.shown(status.owner)) or "another agent"
        stops = f"; the robot drives for {by}: `armadico stop` stops it" if drives else ""
        raise FailedError(f"{refusal}{stops}")
    if plans and NO_MISSION_PLANNING in refusal:
        raise FailedError(f"the goal is cancelled, and it is not known of missions: {refusal}")
    return goal


def _refusal(client: Client, number: int) -> str:
    """Request a cancellation; return why it is refused. Raises AbsentError."""
    from armadico.agents.interface.messages import MissionCancel
    from armadico.mobile.messages import MissionReply
    from armadico.runtime.errors import AbsentError

    request = MissionCancel(number, "armadico mission cancel")
    reply = client.query(request, ANSWER_S, patience=FIND_S)
    if not isinstance(reply, MissionReply):
        raise AbsentError("no agent that takes missions is alive", client.mesh.namespace)
    return options.shown(reply.refusal)


def _board(client: Client) -> Board | None:
    """Return the board of a running society; None: no mission was ever ordered.

    Raises AbsentError if no mission planning agent is alive.
    """
    from armadico.agents.interface.messages import MissionProposal
    from armadico.agents.missions.messages import Board
    from armadico.core.services import service_of
    from armadico.runtime.errors import AbsentError

    client.listen(Board)
    board = client.wait_for(lambda: client.latest(Board), FIND_S)
    key = service_of(MissionProposal).key
    if board is None and not any(card and key in card.provides for card in client.cards().values()):
        raise AbsentError("no agent that plans missions is alive", client.mesh.namespace)
    return board


def _chosen(missions: Sequence[BoardMission], named: str) -> list[BoardMission]:
    """Return the missions with a name or number. Raises FailedError with the nearest name."""
    found = [m for m in missions if named in (m.name, str(m.mission))]
    if not found:
        from armadico.core.config_errors import advice

        known = advice(named, {mission.name for mission in missions})
        raise FailedError(f"no mission {named!r} on the board; {options.shown(known)}")
    return found


def in_a_line(mission: BoardMission) -> str:
    line = f"{mission.name:16} {mission.priority:.1f}  {mission.outcome:10} {mission.mission}"
    doing = "" if mission.over else f"  {mission}"
    note = f"  {mission.note}" if mission.note and mission.over else ""
    return options.shown(f"{line}{doing}{note}")


def plain(mission: BoardMission) -> dict[str, object]:
    """Return a mission of the board for JSON."""
    results = [
        {"step": r.step, "end": r.end, "note": r.note, "at_s": round(r.at, 3)}
        for r in (result.done for result in mission.course.results)
    ]
    return {
        "mission": mission.mission,
        "name": mission.name,
        "priority": mission.priority,
        "state": mission.outcome,
        "by": mission.by,
        "doing": mission.doing,
        "room": mission.room,
        "ahead": [*mission.ahead],
        "note": mission.note,
        "elapsed_s": round(mission.course.elapsed, 3),
        "results": results,
    }


COMMAND: Final = Command(
    "armadico mission",
    Options,
    _show,
    "Show and cancel missions of a running society, or list the shipped ones. Missions are"
    " procedures of several tasks, in TOML: docs/missions.md. `armadico mission run --help` has"
    " the options of a run.",
    EXAMPLES,
)

RUN: Final = Command(
    "armadico mission run",
    RunOptions,
    _run,
    "Run a mission and measure it, as `armadico run` does with a goal. The run ends with the"
    " mission or at its time limit (default: the mission's own, or an hour).",
    RUN_EXAMPLES,
    run.refused,
)

parser = COMMAND.parser  # the options of `run` are RUN's
