"""Watch the society live: alive agents, holders, rates and whether deadlines are met."""

from __future__ import annotations

import json
import math
import socket
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from armadico.cli import options
from armadico.cli.parsing import Command, flag, group, option
from armadico.config.discovery import providers
from armadico.runtime.errors import AbsentError

if TYPE_CHECKING:
    import psutil
    from rich.console import Group

    from armadico.observe.standing import Hosts
    from armadico.observe.view import Seen, View
    from armadico.observe.watching import Watcher

SHOW_S: Final = 0.5
ASK_S: Final = 1.0
MEGABYTE: Final = 1_000_000

EXAMPLES: Final = """\
  armadico top                          live, until Ctrl-C
  armadico top --once                   measure for 3 s, print, end
  armadico top --json --for 10 | jq '.services[] | select(.missed > 0)'
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    once: bool = flag("measure, print once, end; so it does into a pipe")
    json: bool = flag("the same as one JSON object")
    for_s: float = option(
        "with --once and --json: measure for so long (default: 3 s)",
        "--for",
        default=3.0,
        read=options.seconds,
        metavar="S",
    )
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    live = sys.stdout.isatty() and not (args.once or args.json)
    from armadico.observe.view import View
    from armadico.observe.watching import Watcher

    with args.mesh.join(starts=True) if live else args.mesh.joined() as mesh:
        watcher = Watcher([mesh])
        watcher.watch_alive()
        watcher.subscribe()
        snapshots = Snapshots(View(), args.mesh.namespace, args.mesh.agents_by_host())
        watcher.watch_router(snapshots.view)
        if live:
            return _live(snapshots, watcher)
        _measure(snapshots, watcher, args.for_s)
        snapshot = snapshots.at(watcher.clock() / 1e9)  # to leave the mesh takes time
    if args.json:
        print(json.dumps(snapshot, indent=2))
    else:
        from rich.console import Console

        Console().print(tables(snapshot))
    if not snapshot["agents"] and not snapshot["services"]:
        raise AbsentError("no agent is alive", args.mesh.namespace)
    return 0


class Snapshots:
    """What is shown of a view, for programs and for `tables`."""

    def __init__(self, view: View, namespace: str, hosts: Hosts | None = None) -> None:
        self.view, self._hosts = view, hosts or {}
        self._namespace = namespace
        self._processes: dict[int, psutil.Process] = {}

    def at(self, now: float) -> dict[str, Any]:
        """Everything; the time is s of the watcher's clock."""
        from armadico.observe import described

        view, stands = self.view, None
        if view.state is not None:
            stands = described.stands(view, now, providers, self._hosts)
        return {
            "namespace": self._namespace,
            "robot": described.robot(view),
            "pose": described.pose(view, now),
            "mission": described.mission(view),
            "standing": stands,
            "tasks": view.tasks,
            "resources": [described.resource(view, name, now) for name in view.resources],
            "agents": [described.agent(seen) | self._process(seen) for seen in view.agents],
            "services": [described.service(view, key, now) for key in sorted(view.rates)],
        }

    def _process(self, seen: Seen) -> dict[str, Any]:
        """CPU in per cent of one core since the last look, memory in MB; of this host's agents."""
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


def _measure(snapshots: Snapshots, watcher: Watcher, for_s: float) -> None:
    from armadico.observe.watching import show

    end = time.monotonic() + for_s
    ask_at = time.monotonic()
    while (now := time.monotonic()) < end:
        if now >= ask_at:
            ask_at = now + (ASK_S if snapshots.view.complete else SHOW_S / 2)
            watcher.ask_for_cards()
            watcher.ask_for_bids()
            snapshots.at(watcher.clock() / 1e9)  # CPU is measured from here on
        item = watcher.get(min(ask_at, end) - now)
        if item is not None:
            show(snapshots.view, item)
    over = watcher.clock()  # a look may take long, and what came meanwhile is not silence
    while (item := watcher.get(0.0)) is not None and item.at <= over:
        show(snapshots.view, item)


def _live(snapshots: Snapshots, watcher: Watcher) -> int:
    from rich.console import Group
    from rich.live import Live
    from rich.text import Text

    from armadico.observe.watching import show

    (mesh,) = watcher.meshes
    with Live(auto_refresh=False, screen=True) as live:
        try:
            while True:
                watcher.ask_for_cards()
                watcher.ask_for_bids()
                for _ in range(round(ASK_S / SHOW_S)):
                    for item in watcher.until(time.monotonic() + SHOW_S):
                        show(snapshots.view, item)
                    told = tables(snapshots.at(watcher.clock() / 1e9))
                    if not mesh.reachable:
                        told = Group(Text(options.shown(f"{mesh.missing}; waiting for it")), told)
                    live.update(told, refresh=True)
        except KeyboardInterrupt:
            return 0  # how a live view ends


# What it looks like -------------------------------------------------------------------------------


def tables(snapshot: dict[str, Any]) -> Group:
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
            _short(row["holder"]) or "nobody",
            _number(row.get("utility"), 2) + (" critical" if row.get("critical") else ""),
            row.get("term", ""),
            row["obeyed"] or "nobody",
            ", ".join(row["contenders"]),
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
    why = [] if standing is None or not standing["stands"] else standing["sentences"]
    return Group(
        heading,
        *(Text(options.shown(sentence)) for sentence in why),
        _table(("RESOURCE", "HOLDER", "UTILITY", "TERM", "OBEYED", "CONTENDERS"), resources),
        _table(("AGENT", "INSTANCE", "HOST", "PID", "CPU %", "MB"), agents),
        _table(("KEY", "HZ", "PROMISED", "MISSED", "AGE s"), services, late=3),
    )


def _heading(snapshot: dict[str, Any]) -> str:
    robot, where = snapshot["robot"], f"{snapshot['namespace']}: {len(snapshot['agents'])} agents"
    if robot is None:
        return f"{where}, nothing heard of a robot"
    turn = math.degrees(robot["w"])
    words = [where, f"{robot['v']:.2f} m/s", f"{turn:.0f} deg/s", robot["battery"]]
    pose = snapshot["pose"]
    if pose is not None:
        words.append(f"at ({pose['x']:.2f}, {pose['y']:.2f})")
        words += filter(None, [pose["told"]])
    if robot["stopped_by"] is not None:
        words.append(f"STOPPED by {robot['stopped_by'] or 'somebody'}")
    words += ["STALLED"] * robot["stalled"] + ["MOTORS OFF"] * (not robot["motors"])
    if snapshot["mission"] is not None:
        words += filter(None, [snapshot["mission"]["state"], snapshot["mission"]["note"]])
    words += filter(None, [snapshot["tasks"]])
    return ", ".join([*words, *filter(None, [robot["line"]])])


def _table(titles: Sequence[str], rows: Sequence[Sequence[Any]], late: int | None = None) -> Any:
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
    """An instance's id with as much of its bits as people need."""
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
    "Agents, hosts, the holder of each resource, and the measured rate of every key beside what"
    " the table of services promises. MISSED counts silences longer than a key's deadline. CPU"
    " and memory are known for agents of this machine.",
    EXAMPLES,
)
