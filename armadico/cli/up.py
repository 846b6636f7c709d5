"""Start the agents of this machine and keep them running."""

from __future__ import annotations

import os
import signal
import socket
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import coordinations, options
from armadico.cli.additions import Addition, Start, added, beside, checked
from armadico.cli.options import FailedError, Mesh, UsageError
from armadico.cli.parsing import (
    Command,
    argument,
    at_least,
    flag,
    group,
    more_than,
    option,
    several,
)
from armadico.config.endpoints import Endpoints
from armadico.core.errors import UnknownNameError
from armadico.core.unseen import Rule
from armadico.launch.options import (
    X_Y_DEG,
    coordination_option,
    set_option,
    told_option,
    unseen_option,
)
from armadico.mesh.door import launcher
from armadico.mobile.geometry import Pose2

if TYPE_CHECKING:
    from armadico.config.hosts import Host
    from armadico.config.scenarios import Scenario
    from armadico.core.restart_policy import Budget
    from armadico.launch.pidfile import Share
    from armadico.launch.supervisor import Plan

EXAMPLES: Final = """\
  armadico up sc4 --host lab1 --hosts lab.toml     lab1's share of scenario 4
  armadico up --host lab1 --hosts lab.toml         all agents of lab1's entry
  armadico up sc4                                  all agents on this machine
  armadico up rounds                               only the agents that the mission needs
  armadico up fleet --namespace lab/r2 --start 1.5 3 0   one robot of the fleet lab
  armadico up sc4 --host lab1 --hosts demo --with avoid --set avoid.v_max=0.3
  armadico down                                    end them
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    scenario: str | None = argument(
        "the mission or scenario whose agents are started, with its parameters; the mission itself"
        " is not started (default: all agents of the host)",
        nargs="?",
        metavar="MISSION",
    )
    seed: int | None = option(
        "set the simulator's seed (default: the scenario's, or 0)", metavar="N"
    )
    parameters: str | None = option("use this set or file of agents' parameters", metavar="SET")
    sets: tuple[str, ...] = set_option()
    coordination: str | None = coordination_option()
    told: str | None = told_option()
    more: tuple[str, ...] = several(
        "start one more agent, also if another host runs it; may be repeated",
        "--with",
        metavar="AGENT",
    )
    without: tuple[str, ...] = several("leave out one agent; may be repeated", metavar="AGENT")
    start: Pose2 | None = option("set this robot's start pose (default: the scenario's)", **X_Y_DEG)
    robot: str | None = option(
        "connect to this controller (default: the host entry's)", metavar="URL"
    )
    unseen: Rule | None = unseen_option("the scenario's, else the map file's, else drive")
    restarts: int = option(
        "give up after N restarts within --within (default: %(default)s)",
        default=5,
        metavar="N",
        must=at_least(0),
    )
    within: float = option(
        "set the window of --restarts, in s (default: %(default)s)",
        default=30.0,
        metavar="S",
        must=more_than(0),
    )
    journal: bool = flag(
        "publish the inputs and outputs of all agents, so that a recording can be replayed"
    )
    additions: tuple[Addition, ...] = added("up")
    mesh: Mesh = group(Mesh, "the mesh")


def run(args: Options) -> int:
    """Keep the share up until interrupted. Return 0 after SIGTERM (`armadico down`)."""
    from armadico.core.restart_policy import Budget

    if args.coordination == coordinations.LIST:
        return coordinations.show()
    scenario = _started(args, _scenario(args))
    where = _place(args.mesh, scenario)
    start = Start(scenario=scenario, mesh=args.mesh, namespaces=(where.namespace,))
    checked(args.additions, start)
    received = options.end_as_by_ctrl_c()
    plan = _plan(args, where, scenario)
    _check_keys(plan, where)
    budget = Budget(args.restarts, args.within)
    try:
        _keep(plan, where, scenario, budget, beside(args.additions, start))
    except KeyboardInterrupt:
        if signal.SIGTERM in received:
            return 0
        raise
    return 0


def _place(mesh: Mesh, scenario: Scenario | None) -> Endpoints:
    """This host's entry; without a table, an entry with all agents."""
    where = mesh.endpoints(passing=False)
    if where.table is not None:
        return where
    if where.connect:
        raise UsageError("--connect does not define which agents run here; add --hosts")
    from msgspec.structs import replace

    from armadico.config.hosts import HostTable, load_hosts
    from armadico.launch.society import names

    name = socket.gethostname()  # as its agents do, which get no table either
    host = load_hosts().host("localhost")
    chosen = () if scenario is None else names(scenario)
    host = replace(host, agents=tuple(dict.fromkeys((*chosen, *host.agents))))
    return Endpoints(namespace=where.namespace, table=HostTable({name: host}), name=name)


def _scenario(args: Options) -> Scenario | None:
    """The scenario; for a mission, its own scenario with the minimum of agents."""
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
            f"mission {mission.name} names no scenario: add one to its file, as in scenario ="
            ' "house"'
        )
    path = counted_from(Path.cwd() / "command line", args.scenario)
    return least(on_mission(load_scenario(mission.scenario), path))


def _started(args: Options, scenario: Scenario | None) -> Scenario | None:
    """The scenario with `--start` and `--unseen`. Raises UsageError, ConfigError."""
    from msgspec.structs import replace

    from armadico.config.worlds import doubts

    for doubt in () if scenario is None else doubts(scenario.world):
        options.report(doubt)
    if args.unseen is not None:
        if scenario is None:
            raise UsageError("--unseen needs a scenario: add its name")
        scenario = replace(scenario, unseen=args.unseen)
    if args.start is None:
        return scenario
    if scenario is None:
        raise UsageError("--start needs a scenario: add its name")
    from armadico.config.scenarios import scenario_from

    return replace(
        scenario, start=scenario_from(scenario.world, args.start, None, scenario.robot).start
    )


def _is_mission(name: str) -> bool:
    """Whether this is a mission's name or file: a mission has steps, a scenario has none."""
    from armadico.config.loading import document, read_text
    from armadico.config.shipped import find, names
    from armadico.core.config_errors import ConfigNameError

    missions, scenarios = names("missions"), names("scenarios")
    if name in missions:
        return True
    if name in scenarios:
        return False
    if Path(name).name == name and not Path(name).suffix:
        known = {*missions, *scenarios}
        raise ConfigNameError("mission or scenario", name, known)
    path = find("scenarios", name)
    return "steps" in document(read_text(path), path)


def _keep(
    plan: Plan,
    where: Endpoints,
    scenario: Scenario | None,
    budget: Budget,
    company: AbstractContextManager[None],
) -> None:
    """Start the agents of a plan, with `company` beside them, and keep them running."""
    from armadico.config.shipped import counted_from
    from armadico.core.discovery import owners
    from armadico.core.resources import WHEELS
    from armadico.launch.pidfile import PidFile, Share, TakenError
    from armadico.launch.supervisor import Upkeep
    from armadico.runtime.errors import RunFailedError

    here = Path.cwd() / "command line"
    has_robot = any(owners((member.name for member in plan.members), WHEELS))
    mesh = where.mesh(launcher(plan.host), starts=has_robot)
    names = ", ".join(member.name for member in plan.members)
    try:
        with (
            PidFile(where.namespace, plan.host) as pid_file,
            mesh,
            company,
            Upkeep(plan, mesh, _log, budget) as upkeep,
        ):
            running = tuple(member.name for member in plan.members)
            pid_file.write(
                Share(
                    os.getpid(),
                    plan.host,
                    where.namespace,
                    running,
                    str(upkeep.table.logs),
                    "" if where.table is None else where.table.open_port,
                    "" if scenario is None else counted_from(here, scenario.world),
                    "" if scenario is None else counted_from(here, scenario.robot),
                )
            )
            _log(f"{plan.host}: starting {names}; logs are in {upkeep.table.logs}")
            upkeep.start()
            upkeep.keep(_ready(plan.host, names))
    except TakenError as error:
        raise FailedError(_taken(where.namespace, plan.host, error.share)) from None
    except RunFailedError as error:
        raise FailedError(
            f"{plan.host}: {error}\nall agents of {plan.host} were ended; logs are in"
            f" {upkeep.table.logs}"
        ) from None
    except OSError as error:
        raise FailedError(f"cannot write the file of running agents: {error}") from None


def _plan(args: Options, where: Endpoints, scenario: Scenario | None) -> Plan:
    """The plan of this host. Raises UsageError, ConfigError or UnknownNameError."""
    from msgspec.structs import replace

    from armadico.config.hosts import robot_fault, serial_port, unplaced
    from armadico.config.scenarios import Scenario
    from armadico.core.discovery import owners
    from armadico.core.resources import WHEELS
    from armadico.launch.society import Options as Chosen
    from armadico.launch.society import (
        arbiters,
        check,
        check_decided,
        names,
        needed,
        rivals_elsewhere,
        share,
        spare,
        strangers,
        with_arbiters,
        with_sets,
    )
    from armadico.launch.supervisor import Plan

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
        coordination=args.coordination,
        told=args.told,
    )
    if scenario is not None:
        scenario = with_arbiters(scenario, chosen, where.table)
    here = [member.name for member in share(scenario, chosen, host)]
    _check_more(args, here)
    more = (*args.more, *arbiters(scenario, chosen, (*here, *args.more), where.table))
    members = with_sets(share(scenario, chosen, host, more), args.sets)
    if not members:
        raise UsageError(f"host {own} has no agent of {args.scenario or 'the table'} to start")
    if any((args.sets, args.parameters, args.coordination)):  # else there is nothing to check
        check(members)
        others = rivals_elsewhere(scenario, chosen, own, where.table)
        check_decided(members, chosen, whole=not others)
        if others and any("social.coordination=" in each for m in members for each in m.sets):
            _log(
                f"{own}: not checked until they are alive: whether the agents of other hosts"
                f" compete by the same mechanisms ({', '.join(others)}); choose the same ones there"
            )
        for error in strangers(members):
            _log(f"{own}: {error}")
    robot = next(owners((member.name for member in members), WHEELS), None)
    if args.robot is not None and robot is None:
        raise UsageError(f"--robot {args.robot}: host {own} starts no robot agent")
    lacking = unplaced(names(scenario), where.table) if scenario else ()
    if lacking:
        _log(
            f"{args.scenario} needs agents that no host of {where.table.file} runs:"
            f" {', '.join(lacking)}"
        )
    simulated = None
    if host.robot is None and robot is not None:
        simulated = scenario or Scenario(world="empty", start=(0, 0, 0))
    port = serial_port(host.robot) if host.robot else None
    if port is not None and not port.exists():
        _log(f"port {port} does not exist; the robot agent retries until the adapter is connected")
    return Plan(
        own,
        where.namespace,
        members,
        simulated,
        seed,
        tuple(where.words),
        host.together,
        spare(scenario, chosen, host, where.table),
        needed(scenario, chosen, where.table),
        args.journal,
        where.digest,
    )


def _check_keys(plan: Plan, where: Endpoints) -> None:
    """Raises ConfigError if a key is missing, FailedError if the robot would refuse one."""
    from armadico.core.discovery import owners
    from armadico.core.resources import WHEELS
    from armadico.launch.society import processes
    from armadico.mesh.door import ROBOT, name_of

    if where.keys is None:
        return
    labels = [[m.name for m in group] for group in processes(plan.members, plan.together).values()]
    has_robot = any(owners((name for label in labels for name in label), WHEELS))
    for label in labels:
        robot = any(owners(label, WHEELS))
        door = where.door(ROBOT if robot else name_of(label))
        # On the robot's computer all others join by its socket, which asks for no certificate.
        faults = door.faults(False) if door is not None and (robot or not has_robot) else ()
        if faults:
            raise FailedError(f"{plan.host}: {'; '.join(faults)}")
    own = where.door(launcher(plan.host))
    for doubt in () if own is None else own.doubts(labels):
        _log(f"{plan.host}: {doubt}")


def _check_names(args: Options, where: Endpoints, host: Host) -> None:
    """Raises ConfigError or UnknownNameError for an agent that is not installed here."""
    from armadico.config.lines import line_of
    from armadico.config.loading import read_text
    from armadico.core.config_errors import ConfigNameError
    from armadico.core.discovery import AGENTS, find

    file = "" if where.table is None else where.table.file
    for index, name in enumerate(host.agents):
        try:
            find(AGENTS, name)
        except UnknownNameError as error:
            key = (str(where.name), "agents", index)
            line = line_of(read_text(file), key) if file else None
            wrong = ConfigNameError(error.kind, name, error.known)
            raise wrong.at(file or None, line, f"{where.name}.agents: ") from None
    for name in (*args.more, *args.without):
        find(AGENTS, name)


def _check_more(args: Options, here: Sequence[str]) -> None:
    """Raises UsageError for a second agent of a kind of which one is enough on this host."""
    from armadico.config.scenarios import society
    from armadico.core.discovery import agent_class

    for name in args.more:
        if name in here and (agent_class(name).alone or name in society().watch):
            raise UsageError(f"--with {name}: this host starts one already")


def _taken(namespace: str, host: str, share: Share | None) -> str:
    by = "another process" if share is None else f"process {share.pid}"
    return (
        f"{host}'s share of namespace {namespace!r} is up already, by {by};"
        " end it with `armadico down`, or use another --namespace for another robot"
    )


def _ready(host: str, names: str) -> Callable[[float], None]:
    def ready(took: float) -> None:
        try:
            print(f"{host} is up after {took:.1f} s: {names}", flush=True)
        except OSError:  # a closed output must not end the society
            options.discard_output()
        _notify("READY=1")

    return ready


def _notify(text: str) -> None:
    """Notify systemd, if it started this process with a notify socket."""
    where = os.environ.get("NOTIFY_SOCKET")
    if where:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
            line.connect("\0" + where[1:] if where.startswith("@") else where)
            line.send(text.encode())


def _log(text: str) -> None:
    print(f"{time.strftime('%H:%M:%S')} {text}", file=sys.stderr, flush=True)


main: Final = Command(
    "armadico up",
    Options,
    run,
    "Start this machine's agents of the host table and keep them running. An agent that ends is"
    " restarted, within --restarts and --within. This command starts no mission: use"
    " `armadico run SCENARIO --attach` or `armadico goto`.",
    EXAMPLES,
)
