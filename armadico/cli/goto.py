"""Send the robot to a pose, and follow it."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.parsing import (
    BadValueError,
    Command,
    UsageError,
    argument,
    flag,
    group,
    option,
)
from armadico.core.judgement import Answer
from armadico.core.unseen import Rule
from armadico.launch.options import unseen_option
from armadico.observe.findings import Finding, those

if TYPE_CHECKING:
    from armadico.launch.client import Client, Mission

STARTS_S: Final = 20.0
"""How long to wait for a society that is still starting."""

JOINS_S: Final = 3.0
"""How long to wait for a robot agent of which nothing is known yet."""

PLANS_S: Final = 5.0
"""Time for a path planner to answer."""

AGAIN_S: Final = 0.5
"""Period of new attempts while the society starts."""

UNSEEN: Final = (
    "it is not known whether the robot drives; `armadico stop` stops it, `armadico why --live"
    " --standing` tells what is missing"
)
"""What is left behind without a status; a cancellation would not arrive either."""

LINE_S: Final = 2.0
"""Period of progress lines without a terminal."""

SAME_S: Final = 30.0
"""Period of a line that says the same again: a robot may be stopped for hours."""

EXAMPLES: Final = """\
  armadico goto 4 2 90             x 4 m, y 2 m, heading 90 degrees, along a planned path
  armadico goto 4 2                the same place, with the heading of a straight line to it
  armadico goto -1 0.5 -90
  armadico goto kitchen            a room, goal or dock of the map, or an added place
  armadico goto 4 2 90 --direct    straight there, without a plan
  armadico goto 4 2 90 --from 1 1 0   the robot is at x 1 m, y 1 m, heading 0 now
"""


Goal = tuple[float, float, float | None]
"""m, m, rad; None: in the direction from the robot to it."""


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadValueError(f"{text!r} is not a finite number")
    return value


def _metres(text: str) -> float:
    from armadico.core.messages import LARGEST

    value = _number(text)
    if abs(value) > LARGEST:
        raise BadValueError(f"{text!r} m: expected at most {LARGEST:g} m")
    return value


@dataclass(frozen=True, kw_only=True)
class Options:
    to: tuple[str, ...] = argument(
        "X Y [DEG], m in the world frame and a heading in degrees, counter-clockwise (default: from"
        " the robot's position towards X Y, or its own if it is there); or the name of a place: see"
        " `armadico places`",
        nargs="+",
        metavar="GOAL",
    )
    direct: bool = flag("drive straight there, without a plan")
    start: tuple[float, float, float] | None = option(
        "set the robot's present pose, m, m, degrees (default: its estimated pose)",
        "--from",
        read=_number,
        metavar=("X", "Y", "DEG"),
    )
    unseen: Rule | None = unseen_option("the society's")
    timeout: float | None = options.timeout_option("wait at most so long (default: no limit)")
    world: str | None = option(
        "the world that the place is in (default: that of the society that runs here)",
        metavar="MAP",
    )
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    from armadico.launch.client import Client
    from armadico.mobile.messages import through_unseen
    from armadico.observe.watching import Observer
    from armadico.runtime.errors import AbsentError

    to = goal(args)
    mission = None
    try:
        with args.mesh.joined(JOINS_S) as mesh, ExitStack() as stack:
            client, observer = Client(mesh), Observer(mesh, args.mesh.demand())
            mission = _sent(client, args, to)
            if through := through_unseen(mission.unseen):
                print(f"{through}: driven at the speed of sight", flush=True)
            show = _shower(stack, mission.length)

            def progress(going: Mission) -> None:
                observer.take()
                show(going.to_go or 0.0, _remark(going, client, remark(observer.findings)))

            if not mission.wait(args.timeout, progress):
                end = _unreached(mission.failed, args.timeout)
                raise options.FailedError(f"{end}{_late(mission)}")
            doubt = mission.doubt
    except KeyboardInterrupt:
        if mission is not None:
            print(f"\nthe mission continues: {_left_behind(client)}", file=sys.stderr)
        raise
    except AbsentError as error:
        if mission is None:
            raise
        what = f"{error}. The mission continues: {_left_behind(client)}"
        raise options.UnknownError(what) from None
    print(f"{options.shown(doubt) or 'the goal is reached'}{_late(mission)}")
    return options.UNKNOWN if doubt else 0


def goal(args: Options) -> Goal:
    """The goal of the words. Raises UsageError, ConfigError."""
    from armadico.config.named import like_number

    first, *more = args.to
    if not like_number(first):
        place = options.known_gazetteer(args.world, args.mesh.namespace).of(" ".join(args.to))
        return place.x, place.y, place.heading
    if len(more) not in (1, 2):
        words = " ".join(args.to)
        raise UsageError(f"{words}: expected X Y [DEG], or the name of a place")
    try:
        x, y = _metres(first), _metres(more[0])
        return x, y, math.radians(_number(more[1])) if more[1:] else None
    except BadValueError as error:
        raise UsageError(str(error)) from None


def remark(findings: Sequence[Finding]) -> str:
    """Why it stands still, or what else is wrong: the first finding, which others may follow from.

    With the number of the others; "" if nothing is wrong.
    """
    wrong = those(findings, Answer.NO)
    if not wrong:
        return ""
    more = f" ({len(wrong) - 1} more: see `armadico doctor`)" if len(wrong) > 1 else ""
    return options.shown(f"{wrong[0]}{more}")


def _sent(client: Client, args: Options, to: Goal) -> Mission:
    """The accepted mission; waits for a society that is still starting. Raises SocietyError."""
    from armadico.mobile.messages import Pose
    from armadico.runtime.errors import AbsentError, MissionRefusedError

    client.listen(Pose)
    start = args.start and (*args.start[:2], math.radians(args.start[2]))
    end, said = time.monotonic() + min(args.timeout or STARTS_S, STARTS_S), ""
    ready: bool | None = False
    while True:
        try:
            return client.goto(
                *to, direct=args.direct, start=start, unseen=args.unseen, by="armadico goto"
            )
        except (AbsentError, MissionRefusedError) as error:
            was_ready, ready = ready, _ready(client, args, to)
            # What was missing may have come since the refusal: one more try shows it.
            if time.monotonic() >= end or not client.alive or ready is None or was_ready:
                raise
            if not ready and said != (said := options.shown(error.args[0])):
                refused = isinstance(error, MissionRefusedError)
                what = "the goal is refused" if refused else "waiting for the society to start"
                options.report(f"{what}: {said}{'; asking again' if refused else ''}")
            client.wait_for(lambda: None, AGAIN_S)


def _ready(client: Client, args: Options, to: Goal) -> bool | None:
    """Whether there are a pose and a planner now; None: the planner refuses the goal."""
    from armadico.mobile.messages import Plan, PlanRequest, Pose, Waypoint

    pose = client.fresh(Pose)
    if pose is None or args.direct:
        return pose is not None
    here, goal = Waypoint(pose.x, pose.y, pose.theta), Waypoint(to[0], to[1], 0.0)
    plan = client.query(PlanRequest(here, goal), PLANS_S, patience=0.0)
    if isinstance(plan, Plan) and plan.refusal:
        return None
    return plan is not None


def _unreached(failed: str | None, timeout: float | None) -> str:
    """Why the wait for a goal ended before it was reached; without a timeout it has failed."""
    if failed is None and timeout is not None:
        return f"not there after {timeout:g} s; the mission continues"
    return f"it failed, {options.shown(failed or 'no reason was reported')}"


def _late(mission: Mission) -> str:
    """What a late mission adds to its end."""
    status = mission.status
    return "" if status is None or not status.late else f"; {options.shown(status.late)}"


def _left_behind(client: Client) -> str:
    """What the robot does after the command."""
    from armadico.core.hands import release
    from armadico.core.messages import RobotState

    last, fresh = client.latest(RobotState), client.fresh(RobotState)
    if last is not None and last.stop.stopped:
        by, how = options.shown(last.stop.requester), release(last.stop, motors=last.motors)
        was = "is" if fresh else "was last seen"
        return f"the robot {was} stopped by {by}; it drives on only after {how}"
    return "the robot drives on; `armadico stop` stops it" if fresh else UNSEEN


def _remark(mission: Mission, client: Client, reason: str) -> str:
    from armadico.core.hands import release
    from armadico.core.messages import RobotState
    from armadico.observe.view import RESTS, speed

    state, status = client.fresh(RobotState), mission.status
    if state is None:
        return reason or "no message from the robot"
    if state.stop.stopped:
        by, how = options.shown(state.stop.requester), release(state.stop, motors=state.motors)
        return f"stopped by {by}; {how}"
    if status is not None and (status.note or status.late):
        said = options.shown(status.note or status.late)
        return said if status.note else f"{options.shown(speed(state))}, {said}"
    moves = max(abs(state.v), abs(state.w)) > RESTS
    words = [options.shown(speed(state))] * (moves or not reason) + [reason] * bool(reason)
    return "stalled" if state.stalled and not reason else ", ".join(words)


def _shower(stack: ExitStack, length: float) -> Callable[[float, str], None]:
    """A function of metres to go and a remark: a bar on a terminal, else a line every `LINE_S`."""
    if not sys.stdout.isatty():
        return _Lines().show
    from rich.progress import BarColumn, Progress, TextColumn

    columns = (BarColumn(), TextColumn("{task.description}", markup=False))
    progress = stack.enter_context(Progress(*columns, transient=True))
    task = progress.add_task("", total=max(length, 1e-3))

    def show(to_go: float, remark: str) -> None:
        progress.update(
            task, completed=max(length - to_go, 0.0), description=f"{to_go:.2f} m to go, {remark}"
        )

    return show


class _Lines:
    def __init__(self) -> None:
        self._printed_at = float("-inf")
        self._line = ""

    def show(self, to_go: float, remark: str) -> None:
        now, line = time.monotonic(), f"{to_go:.2f} m to go, {remark}"
        if now - self._printed_at >= (SAME_S if line == self._line else LINE_S):
            self._printed_at, self._line = now, line
            print(line, flush=True)


main: Final = Command(
    "armadico goto",
    Options,
    run,
    "Send the robot to a pose or a named place and wait until it arrives. Ctrl-C ends the"
    " command, not the drive.",
    EXAMPLES,
)
