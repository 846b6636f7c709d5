"""Show the agents' logs: live, or those of the last run."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import Command, argument, flag, group, option

if TYPE_CHECKING:
    from armadico.observe.watching import Received

LEVELS: Final = {"debug": 10, "info": 20, "warning": 30, "error": 40}

EXAMPLES: Final = """\
  armadico logs -f                        all agents, live
  armadico logs -f avoid --level warning
  armadico logs                           the logs of the robot's last run on this machine
  armadico logs --namespace hall/r1       also those of a robot of the fleet hall
  armadico logs robot --folder /tmp/armadico-robot1-1a2b3c4d
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    agent: str | None = argument(
        "only this agent, by name or instance (default: all)", nargs="?", metavar="AGENT"
    )
    follow: bool = flag("show new lines until Ctrl-C", "-f", "--follow")
    level: str = option(
        "with -f: the least level (default: debug)", default="debug", choices=tuple(LEVELS)
    )
    folder: Path | None = option(
        "read the logs of this folder (default: those of the robot's last run)", metavar="DIR"
    )
    timeout: float | None = options.timeout_option("with -f: end after S seconds")
    json: bool = flag("print one JSON object a line")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    if args.follow and args.folder is not None:
        raise UsageError("--folder reads log files, -f follows published lines: use one of them")
    ours = options.Mesh(namespace=args.mesh.namespace)
    if not args.follow and (args.mesh != ours or args.level != "debug" or args.timeout):
        raise UsageError(
            "--level, --timeout and the options of the mesh but --namespace select published lines:"
            " add -f; --folder DIR selects the log files of another run"
        )
    return _follow(args) if args.follow else _read(args)


def _follow(args: Options) -> int:
    mesh = args.mesh.join()
    from armadico.observe.watching import Received, Watcher

    with mesh:
        watcher = Watcher([mesh])
        watcher.subscribe("log/**")
        end = time.monotonic() + (args.timeout or float("inf"))
        while (left := end - time.monotonic()) > 0:
            item = watcher.get(min(left, 60.0))
            if isinstance(item, Received):
                _show(args, item)
    return 0


def _show(args: Options, item: Received) -> None:
    from armadico.core.membership import agent_of
    from armadico.core.messages import Log
    from armadico.observe.watching import read_or_none

    instance = item.key.partition("/")[2]
    message = read_or_none(item)
    if not isinstance(message, Log) or message.level < LEVELS[args.level]:
        return
    if args.agent not in (None, agent_of(instance), instance):
        return
    if args.json:
        found: dict[str, object] = {"t": item.at / 1e9, "instance": instance}
        print(json.dumps(found | {"level": message.level, "text": message.text}), flush=True)
        return
    clock = time.strftime("%H:%M:%S", time.localtime(item.at / 1e9))
    stamp = f"{clock}.{item.at // 1_000_000 % 1000:03d} {agent_of(instance)}"
    print(options.shown(f"{stamp} {_name(message.level)} {message.text}"), flush=True)


def _name(level: int) -> str:
    below = [name for name, least in LEVELS.items() if least <= level]
    return (below[-1] if below else "debug").upper()


def _read(args: Options) -> int:
    folder, prefix = (args.folder, "") if args.folder else _newest(args.mesh.namespace)
    if args.folder is None:
        print(f"from {folder}", file=sys.stderr)  # the newest may be another run's
    if not folder.is_dir():
        raise UsageError(f"--folder {folder}: no such folder")
    files = {file.stem.removeprefix(prefix): file for file in sorted(folder.glob(f"{prefix}*.log"))}
    chosen = {name: file for name, file in files.items() if args.agent in (None, name)}
    if not chosen:
        names = ", ".join(files) or "none"
        wanted = f"log of {args.agent!r}" if args.agent else "log"
        raise FailedError(f"no {wanted} in {folder}; there are logs of: {names}")
    for stamp, name, text in sorted(_lines(chosen), key=lambda line: line[0]):
        found = {"time": stamp, "agent": name, "text": text}
        print(json.dumps(found) if args.json else options.shown(text))
    return 0


def _newest(namespace: str) -> tuple[Path, str]:
    """The folder of a robot's last run on this machine, and how its logs begin there.

    A fleet has one folder for all its robots. Raises FailedError.
    """
    from armadico.launch.processes import logs_folders

    there = logs_folders()
    fleet, _, robot = namespace.rpartition("/")
    found = [
        (folder, "" if name == namespace else f"{robot}-")
        for name, folder in there
        if name == namespace or (name == fleet and any(folder.glob(f"{robot}-*.log")))
    ]
    if not found:
        others = ", ".join(sorted({name for name, _ in there}))
        raise FailedError(
            f"no run of {namespace!r} on this machine left log files;"
            + (f" there are logs of {others}: choose with --namespace;" if others else "")
            + " `armadico logs -f` shows new lines, and `armadico record` keeps them"
        )
    return found[-1]


def _lines(files: Mapping[str, Path]) -> Iterator[tuple[str, str, str]]:
    """(time of day, name, line) of each line; a line without a time has that of the line before."""
    for name, file in files.items():
        stamp = ""
        for line in file.read_text(encoding="utf-8", errors="replace").splitlines():
            first = line.partition(" ")[0]
            stamp = first if len(first) == 12 and first[2:3] == first[5:6] == ":" else stamp
            yield stamp, name, line


main: Final = Command(
    "armadico logs",
    Options,
    run,
    "Show the agents' logs. With -f new lines are shown as they are published; published lines are"
    " not kept. Without -f the log files of the robot's last run on this machine are read."
    " `armadico record` keeps everything.",
    EXAMPLES,
)
