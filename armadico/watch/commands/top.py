"""Watch the society live: alive agents, holders, rates and missed deadlines."""

from __future__ import annotations

import json
import math
import signal
import socket
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.parsing import Command, flag, group, option
from armadico.observe.findings import NOTHING, Demand, sight
from armadico.runtime.errors import AbsentError

if TYPE_CHECKING:
    import psutil
    from rich.console import Group
    from rich.table import Table

    from armadico.observe.described import Section
    from armadico.observe.view import Seen, View
    from armadico.observe.watching import Observer

SHOW_S: Final = 0.5
MEGABYTE: Final = 1_000_000
CARD: Final = ("host", "pid", "version")  # fields of an agent's card that are shown

EXAMPLES: Final = """\
  armadico top                          live, until Ctrl-C
  armadico top --once                   measure for 3 s, print, end
  armadico top --json --for 10 | jq '.services[] | select(.missed > 0)'
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    once: bool = flag("measure, print once and end; the default without a terminal")
    json: bool = flag("the same, printed as one JSON object")
    for_s: float = option(
        "with --once and --json: measure for S seconds (default: 3)",
        "--for",
        default=3.0,
        read=options.seconds,
        metavar="S",
    )
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    live = sys.stdout.isatty() and not (args.once or args.json)
    from armadico.observe.watching import Observer

    with args.mesh.join(starts=True) if live else args.mesh.joined() as mesh:
        observer = Observer(mesh, args.mesh.demand())
        snapshots = Snapshots(observer.view, args.mesh.namespace, observer.demand)
        if live:
            return _live(snapshots, observer)
        _measure(snapshots, observer, args.for_s)
        snapshot = snapshots.at(observer.now)  # before closing the mesh, which takes time
        code = sight(observer.findings)
    if args.json:
        print(json.dumps(snapshot, indent=2))
    else:
        from rich.console import Console

        Console().print(tables(snapshot))
    if not snapshot["agents"] and not snapshot["services"]:
        raise AbsentError("no agent is alive", args.mesh.namespace)
    return code


class Snapshots:
    """A view as JSON objects, which `tables` shows."""

    def __init__(self, view: View, namespace: str, demand: Demand = NOTHING) -> None:
        self.view, self._demand = view, demand
        self._namespace = namespace
        self._processes: dict[int, psutil.Process] = {}

    def at(self, now: float) -> Section:
        """All that is shown; `now` is the watcher's clock, s."""
        from armadico.observe import described

        view = self.view
        return {
            "namespace": self._namespace,
            "connected": view.state_is_fresh(now),
            "silent_s": None if view.state_at is None else round(now - view.state_at, 1),
            "robot": described.robot(view),
            "pose": described.pose(view, now),
            "slam": described.slam(view, now),
            "mission": described.mission(view, now),
            "standing": described.diagnosis(view, now, self._demand),
            "tasks": view.tasks,
            "resources": [described.resource(view, name, now) for name in view.resources],
            "agents": [described.agent(seen, *CARD) | self._process(seen) for seen in view.agents],
            "services": [described.service(view, key, now) for key in sorted(view.rates)],
        }

    def _process(self, seen: Seen) -> Section:
        """CPU since the last call, % of one core, and memory, MB; of this host's agents."""
        import psutil

        if seen.card is None or seen.card.host != socket.gethostname():
            return {}
        pid = seen.card.pid
        try:
            process = self._processes.setdefault(pid, psutil.Process(pid))
            memory = process.memory_info().rss / MEGABYTE
            return {"cpu_percent": process.cpu_percent(), "memory_mb": round(memory, 1)}
        except psutil.Error:
            return {}


def _measure(snapshots: Snapshots, observer: Observer, for_s: float) -> None:
    for _ in range(steps := max(round(for_s / SHOW_S), 1)):
        snapshots.at(observer.now)  # CPU is measured from here on
        observer.take(for_s / steps)


def _live(snapshots: Snapshots, observer: Observer) -> int:
    from rich.console import Group
    from rich.live import Live
    from rich.text import Text

    (mesh,) = observer.watcher.meshes
    signals: list[int] = []
    # A KeyboardInterrupt raised within `cbor2.dumps` is ignored (cbor2 6.2), and queries need it.
    before = signal.signal(signal.SIGINT, lambda number, _: signals.append(number))
    with Live(auto_refresh=False, screen=True) as live:
        while not signals:
            observer.take(SHOW_S)
            screen = tables(snapshots.at(observer.now))
            if not mesh.reachable:
                waiting = Text(options.shown(f"{mesh.missing}; waiting for it"))
                screen = Group(waiting, screen)
            live.update(screen, refresh=True)
    signal.signal(signal.SIGINT, before)
    return 0


# Tables -------------------------------------------------------------------------------------------


def tables(snapshot: Section) -> Group:
    from rich.console import Group
    from rich.text import Text

    heading = Text(options.shown(_heading(snapshot)), style="bold")
    agents = [
        (
            row["name"],
            row["instance"].rpartition("-")[2][:8],
            row.get("host", "not answering"),
            row.get("pid", ""),
            _number(row.get("cpu_percent"), 1),
            _number(row.get("memory_mb"), 0),
        )
        for row in snapshot["agents"]
    ]
    resources = [
        (
            row["resource"],
            _short(row["holder"]) or "none",
            _number(row.get("utility"), 2) + (" critical" if row.get("critical") else ""),
            row.get("term", ""),
            row["obeyed"] or "none",
            ", ".join(each["name"] for each in row["contenders"]),
        )
        for row in snapshot["resources"]
    ]
    services = [
        (
            row["key"],
            _number(row["hz"], 1),
            _number(row["promised_hz"], 0),
            row["missed"] or "",
            _number(row["age_s"], 1),
        )
        for row in snapshot["services"]
    ]
    standing = snapshot["standing"]
    why = [*standing["sentences"]] if standing["stands"] else []
    why += standing["beside"]
    return Group(
        heading,
        *(Text(options.shown(sentence)) for sentence in why),
        _table(("RESOURCE", "HOLDER", "UTILITY", "TERM", "OBEYED", "CONTENDERS"), resources),
        _table(("AGENT", "INSTANCE", "HOST", "PID", "CPU %", "MB"), agents),
        _table(("KEY", "HZ", "PROMISED", "MISSED", "AGE s"), services, late=3),
    )


def _heading(snapshot: Section) -> str:
    from armadico.mobile.messages import MissionState

    robot, where = snapshot["robot"], f"{snapshot['namespace']}: {len(snapshot['agents'])} agents"
    if robot is None:
        return f"{where}, no message from a robot"
    if not snapshot["connected"]:
        where += f", no message from the robot for {snapshot['silent_s']:.1f} s; before that"
    turn = math.degrees(robot["w"])
    words = [where, robot["speed"], f"{turn:.0f} deg/s", robot["battery"]]
    pose = snapshot["pose"]
    if pose is not None:
        words.append(f"at ({pose['x']:.2f}, {pose['y']:.2f})")
        words += filter(None, [pose["pose_text"]])
    if (slam := snapshot["slam"]) is not None:
        words.append(f"map: {slam['summary']}")
        words += [f"the map may be wrong: {slam['uncertain']}"] * bool(slam["uncertain"])
    if robot["stopped_by"] is not None:
        words.append(f"STOPPED by {robot['stopped_by'] or 'an unknown client'}")
    words += ["STALLED"] * robot["stalled"] + ["MOTORS OFF"] * (not robot["motors"])
    if (mission := snapshot["mission"]) is not None:
        waits = mission["state"] == MissionState.DRIVING and snapshot["standing"]["stands"]
        state = "its goal waits" if waits else mission["state"]
        state = "no goal" if state == MissionState.NONE else state
        if mission["silent_s"] is not None:
            state = f"{mission['silent_s']:.0f} s ago {state}"
        words += filter(None, (state, mission["note"], mission["late"]))
    words += filter(None, [snapshot["tasks"]])
    return ", ".join([*words, *filter(None, [robot["line"]])])


def _table(
    titles: Sequence[str], rows: Sequence[Sequence[object]], late: int | None = None
) -> Table:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, header_style="bold cyan", pad_edge=False, expand=False)
    for title in titles:
        table.add_column(title, no_wrap=True)
    for row in rows:
        style = "red" if late is not None and row[late] else None
        table.add_row(*(Text(options.shown(cell)) for cell in row), style=style)
    return table


def _short(instance: str | None) -> str:
    """An instance's name with the first 8 characters of its id."""
    if instance is None:
        return ""
    name, dash, bits = instance.rpartition("-")
    return f"{name}{dash}{bits[:8]}"


def _number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


main: Final = Command(
    "armadico top",
    Options,
    run,
    "Show agents, hosts, the holder of each resource, and the measured and promised rate of every"
    " key. MISSED counts gaps longer than a key's deadline. CPU and memory are shown for agents of"
    " this machine. With --once and --json the exit code is 1 if something that should be there is"
    " absent or does not answer, and 3 if that is not known.",
    EXAMPLES,
)
