"""Start this machine's share of a society, and keep it running."""

from __future__ import annotations

import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, Mesh, UsageError
from armadico.cli.parsing import (
    POSE,
    Command,
    argument,
    at_least,
    flag,
    group,
    more_than,
    option,
    several,
)
from armadico.cli.run_options import X_Y_DEG, pose
from armadico.config.discovery import UnknownNameError
from armadico.config.errors import ConfigError
from armadico.mesh.endpoints import Endpoints

if TYPE_CHECKING:
    from types import FrameType

    from armadico.agents.supervision.supervisor import Plan
    from armadico.config.hosts import Host
    from armadico.config.scenarios import Scenario
    from armadico.launch.society import Member

EXAMPLES: Final = """\
  armadico up sc4 --host lab1 --hosts lab.toml     lab1's share of scenario 4
  armadico up --host lab1 --hosts lab.toml         all agents of lab1's entry
  armadico up sc4                                  everybody on this machine
  armadico up house --page                         and a page to click on; Ctrl-C ends both
  armadico up rounds                               as few as that mission needs
  armadico up fleet --namespace lab/r2 --start 1.5 3 0   one robot of the fleet lab
  armadico up sc4 --host lab1 --hosts demo --with avoid --set avoid.v_max=0.3
  armadico down                                    end it
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    scenario: str | None = argument(
        "a mission, or a scenario: only its agents, set as it says (default: the host's, as is)",
        nargs="?",
        metavar="MISSION",
    )
    seed: int | None = option("of the simulator, if it starts one", metavar="N")
    parameters: str | None = option("a set of agents' parameters, or a file", metavar="SET")
    set: tuple[str, ...] = several(
        "one parameter of one agent; may be repeated", metavar="AGENT.KEY=VALUE"
    )
    more: tuple[str, ...] = several(
        "one more, whoever else has it; may be repeated", "--with", metavar="AGENT"
    )
    without: tuple[str, ...] = several("leave one out", metavar="AGENT")
    start: tuple[float, float, float] | None = option(
        "where this robot starts, if not where the scenario has it", metavar=X_Y_DEG, must=POSE
    )
    robot: str | None = option("the controller, instead of the host entry's", metavar="URL")
    restarts: int = option(
        "give up after (default %(default)s)", default=5, metavar="N", must=at_least(0)
    )
    within: float = option(
        "in so many s (default %(default)s)", default=30.0, metavar="S", must=more_than(0)
    )
    journal: bool = flag(
        "the agents publish what enters and leaves them, so that a recording can be replayed"
    )
    page: bool = flag("serve the control page as well, until this ends; the link is printed")
    mesh: Mesh = group(Mesh, "the mesh")


def run(args: Options) -> int:
    """Keep the share running until interrupted; return 0 after SIGTERM, as by `armadico down`."""
    scenario = _started(args, _scenario(args))
    where = _place(args.mesh, scenario)
    with _signals() as received:
        try:
            _keep(args, where, scenario)
        except KeyboardInterrupt:
            if signal.SIGTERM in received:
                return 0
            raise
    return 0


def _place(mesh: Mesh, scenario: Scenario | None) -> Endpoints:
    """Return this host of the table; without a table, one that runs all agents."""
    where = mesh.endpoints(passing=False)
    if where.table is not None:
        return where
    if where.connect:
        raise UsageError("--connect says nothing of who runs here; name --hosts")
    from msgspec.structs import replace

    from armadico.config.hosts import HostTable, load_hosts
    from armadico.launch.society import names

    name = socket.gethostname()  # its agents use the same name without a table
    host = load_hosts().host("localhost")
    taking = () if scenario is None else names(scenario)
    host = replace(host, agents=tuple(dict.fromkeys((*taking, *host.agents))))
    return Endpoints(namespace=where.namespace, table=HostTable({name: host}), name=name)


def _scenario(args: Options) -> Scenario | None:
    """Return the mission in its own scenario, with the least society, or the scenario."""
    if args.scenario is None:
        return None
    from armadico.config.scenarios import load_scenario, on_mission
    from armadico.launch.society import least

    if not _is_mission(args.scenario):
        return on_mission(load_scenario(args.scenario))
    from armadico.config.errands import load_mission
    from armadico.config.shipped import counted_from

    mission = load_mission(args.scenario)
    if mission.scenario is None:
        raise UsageError(
            f"{mission.name} names no scenario, so nobody knows where it is done: say one in its"
            ' file (scenario = "house")'
        )
    path = counted_from(Path.cwd() / "command line", args.scenario)
    return least(on_mission(load_scenario(mission.scenario), path))


def _started(args: Options, scenario: Scenario | None) -> Scenario | None:
    """Return the scenario with the given start. Raises UsageError, ConfigError."""
    from armadico.config.worlds import bare

    if scenario is not None and (warning := bare(scenario.world)):
        options.say(warning)
    start = pose(args.start)
    if start is None:
        return scenario
    if scenario is None:
        raise UsageError("--start is in a scenario's world: name one")
    from msgspec.structs import replace

    from armadico.config.scenarios import scenario_from

    return replace(scenario, start=scenario_from(scenario.world, start, None, scenario.robot).start)


def _is_mission(name: str) -> bool:
    """Return whether a name or file is a mission's: it has steps, and a scenario has none."""
    from armadico.config.errors import advice
    from armadico.config.loading import document, read_text
    from armadico.config.shipped import find, names

    missions, scenarios = names("missions"), names("scenarios")
    if name in missions:
        return True
    if name in scenarios:
        return False
    if Path(name).name == name and not Path(name).suffix:
        known = {*missions, *scenarios}
        raise ConfigError(f"no mission and no scenario {name!r}; {advice(name, known)}")
    path = find("scenarios", name)
    return "steps" in document(read_text(path), path)


def _keep(args: Options, where: Endpoints, scenario: Scenario | None) -> None:
    from armadico.agents.supervision.supervisor import Upkeep
    from armadico.cli.beside import beside
    from armadico.config.discovery import owners
    from armadico.core.resources import WHEELS
    from armadico.core.restart_policy import Budget
    from armadico.launch.pidfile import PidFile, Share, TakenError
    from armadico.runtime.errors import RunFailedError

    plan = _plan(args, where, scenario)
    has_robot = any(owners((member.name for member in plan.members), WHEELS))
    mesh = where.mesh(starts=has_robot)
    names = ", ".join(member.name for member in plan.members)
    budget = Budget(args.restarts, args.within)
    try:
        with (
            PidFile(where.namespace, plan.host) as pid_file,
            mesh,
            beside(
                args.mesh, "page", None if scenario is None else scenario.world, wanted=args.page
            ),
            Upkeep(plan, mesh, _say, budget) as upkeep,
        ):
            running = tuple(member.name for member in plan.members)
            pid_file.write(
                Share(os.getpid(), plan.host, where.namespace, running, str(upkeep.table.logs))
            )
            _say(f"{plan.host}: starting {names}; logs are in {upkeep.table.logs}")
            upkeep.start()
            upkeep.keep(_ready(plan.host, names))
    except TakenError as error:
        raise FailedError(_taken(where.namespace, plan.host, error.share)) from None
    except RunFailedError as error:
        raise FailedError(
            f"{plan.host}: {error}\neverything of {plan.host} was ended; logs are in"
            f" {upkeep.table.logs}"
        ) from None
    except OSError as error:
        raise FailedError(f"cannot keep a file that says what is up: {error}") from None


def _plan(args: Options, where: Endpoints, scenario: Scenario | None) -> Plan:
    """Return the processes of this host. Raises UsageError, ConfigError or UnknownNameError."""
    from msgspec.structs import replace

    from armadico.agents.supervision.supervisor import Plan
    from armadico.config.discovery import owners
    from armadico.config.hosts import nobodys, robot_fault, serial_port
    from armadico.config.scenarios import Scenario
    from armadico.core.resources import WHEELS
    from armadico.launch.society import Options as Chosen
    from armadico.launch.society import names, needed, share, spare

    assert where.table is not None, "an agent is on a host of one"
    host, own = where.host, str(where.name)
    if args.robot is not None:
        if fault := robot_fault(args.robot):
            raise UsageError(f"--robot {args.robot!r}: {fault}")
        host = replace(host, robot=args.robot)
    _check_names(args, where, host)
    seed = args.seed if args.seed is not None else (scenario.seed if scenario else 0)
    chosen = Chosen(
        seed=seed,
        parameters=args.parameters,
        without=args.without,
        namespace=where.namespace,
    )
    members = share(scenario, chosen, host, args.more)
    if not members:
        raise UsageError(f"nothing of {args.scenario or 'the table'} is {own}'s to start")
    robot = next(owners((member.name for member in members), WHEELS), None)
    if args.robot is not None and robot is None:
        raise UsageError(f"--robot {args.robot}: {own} starts no robot agent here")
    lacking = nobodys(names(scenario), where.table) if scenario else ()
    if lacking:
        _say(f"{args.scenario} needs what no host of {where.table.file} runs: {', '.join(lacking)}")
    simulated = None
    if host.robot is None and robot is not None:
        simulated = scenario or Scenario(world="empty", start=(0, 0, 0))
    port = serial_port(host.robot) if host.robot else None
    if port is not None and not port.exists():
        _say(f"there is no {port} yet; the robot agent looks for it until the adapter is there")
    return Plan(
        own,
        where.namespace,
        _set(args, members),
        simulated,
        seed,
        tuple(where.words),
        host.together,
        spare(scenario, chosen, host, where.table),
        needed(scenario, chosen, where.table),
        args.journal,
    )


def _check_names(args: Options, where: Endpoints, host: Host) -> None:
    """Raises ConfigError or UnknownNameError for an agent that is not installed here."""
    from armadico.config.discovery import AGENTS, find
    from armadico.config.lines import line_of
    from armadico.config.loading import read_text

    file = "" if where.table is None else where.table.file
    for index, name in enumerate(host.agents):
        try:
            find(AGENTS, name)
        except UnknownNameError as error:
            key = (str(where.name), "agents", index)
            line = line_of(read_text(file), key) if file else None
            raise ConfigError(f"{where.name}.agents: {error}", file or None, line) from None
    for name in (*args.more, *args.without):
        find(AGENTS, name)


def _set(args: Options, members: Sequence[Member]) -> tuple[Member, ...]:
    """Return the members with the values of `--set`. Raises ConfigError for invalid ones."""
    found = tuple(_with_sets(member, args.set, members) for member in members)
    if args.set or args.parameters is not None:  # else nobody has written any
        from armadico.launch.society import check

        check(found)
    return found


def _with_sets(member: Member, sets: Sequence[str], members: Sequence[Member]) -> Member:
    """Return a member with the values of `--set`. Raises UsageError for an unknown name."""
    from armadico.launch.society import Member

    mine = []
    for setting in sets:
        name, dot, rest = setting.partition(".")
        if not dot or "=" not in rest:
            raise UsageError(f"--set {setting}: expected AGENT.KEY=VALUE, avoid.v_max=0.3 say")
        if name not in {other.name for other in members}:
            here = ", ".join(dict.fromkeys(other.name for other in members))
            raise UsageError(f"--set {setting}: {name} is not started here ({here} are)")
        if name == member.name:
            mine.append(rest)
    return Member(member.name, (*member.sets, *mine))


def _taken(namespace: str, host: str, share: object) -> str:
    from armadico.launch.pidfile import Share

    by = f"process {share.pid}" if isinstance(share, Share) else "another process"
    return (
        f"{host}'s share of namespace {namespace!r} is up already, by {by};"
        " `armadico down` ends it, another robot needs a --namespace of its own"
    )


def _ready(host: str, names: str) -> Callable[[float], None]:
    def ready(took: float) -> None:
        try:
            print(f"{host} is up after {took:.1f} s: {names}", flush=True)
        except OSError:  # the society does not end because its launcher cannot report
            options.unheard()
        _notify("READY=1")

    return ready


def _notify(text: str) -> None:
    """Notify systemd, if it has requested that."""
    where = os.environ.get("NOTIFY_SOCKET")
    if where:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
            line.connect("\0" + where[1:] if where.startswith("@") else where)
            line.send(text.encode())


@contextmanager
def _signals() -> Iterator[list[int]]:
    """SIGTERM and SIGHUP end it as Ctrl-C does; yields those that came."""
    received: list[int] = []

    def interrupt(number: int, _cycle: FrameType | None) -> None:
        received.append(number)
        raise KeyboardInterrupt

    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:  # under nohup it is not
            signal.signal(number, interrupt)
    yield received


def _say(text: str) -> None:
    print(f"{time.strftime('%H:%M:%S')} {text}", file=sys.stderr, flush=True)


main: Final = Command(
    "armadico up",
    Options,
    run,
    "Start this machine's share of a society, as the host table has it, and keep it up: who"
    " ends is started again, so many times in so many seconds. The mission is somebody else's:"
    " armadico run SCENARIO --attach, or armadico goto.",
    EXAMPLES,
)
