"""Read the agents' logs: from now on, or those of the last run."""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from armadico.cli import options
from armadico.cli.options import FailedError, UsageError
from armadico.cli.parsing import Command, argument, flag, group, option

if TYPE_CHECKING:
    from armadico.observe.watching import Heard

LEVELS: Final = {"debug": 10, "info": 20, "warning": 30, "error": 40}

FOLDERS: Final = "armadico-*"
"""Where `armadico run` has its processes write, in the folder for temporary files."""

EXAMPLES: Final = """\
  armadico logs -f                        everybody, from now on
  armadico logs -f avoid --level warning
  armadico logs                           what the processes of the last `armadico run` wrote
  armadico logs robot --folder /tmp/armadico-1a2b3c
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    agent: str | None = argument("only this agent, by name or id", nargs="?", metavar="AGENT")
    follow: bool = flag("from now on, until Ctrl-C", "-f", "--follow")
    level: str = option("with -f: at least", default="debug", choices=tuple(LEVELS))
    folder: Path | None = option("what a run wrote there", metavar="DIR")
    timeout: float | None = options.timeout_option("with -f: end after so long")
    json: bool = flag("one JSON object a line, for programs")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    if args.follow and args.folder is not None:
        raise UsageError("--folder has what was written; -f follows what is published")
    return _follow(args) if args.follow else _read(args)


def _follow(args: Options) -> int:
    mesh = args.mesh.join()
    from armadico.observe.watching import Heard, Watcher

    with mesh:
        watcher = Watcher([mesh])
        watcher.subscribe("log/**")
        end = time.monotonic() + (args.timeout or float("inf"))
        while (left := end - time.monotonic()) > 0:
            item = watcher.get(min(left, 60.0))
            if isinstance(item, Heard):
                _show(args, item)
    return 0


def _show(args: Options, item: Heard) -> None:
    from armadico.core.messages import Log
    from armadico.observe.view import agent_of
    from armadico.observe.watching import read_or_none

    instance = item.key.partition("/")[2]
    message = read_or_none(item)
    if not isinstance(message, Log) or message.level < LEVELS[args.level]:
        return
    if args.agent not in (None, agent_of(instance), instance):
        return
    if args.json:
        found: dict[str, Any] = {"t": item.at / 1e9, "instance": instance}
        print(json.dumps(found | {"level": message.level, "text": message.text}), flush=True)
        return
    clock = time.strftime("%H:%M:%S", time.localtime(item.at / 1e9))
    stamp = f"{clock}.{item.at // 1_000_000 % 1000:03d} {agent_of(instance)}"
    print(options.shown(f"{stamp} {_name(message.level)} {message.text}"), flush=True)


def _name(level: int) -> str:
    below = [name for name, least in LEVELS.items() if least <= level]
    return (below[-1] if below else "debug").upper()


def _read(args: Options) -> int:
    folder = args.folder or _newest()
    if args.folder is None:
        print(f"from {folder}", file=sys.stderr)  # the newest need not be the run that is meant
    if not folder.is_dir():
        raise UsageError(f"--folder {folder}: no such folder")
    files = sorted(folder.glob("*.log"))
    chosen = [file for file in files if args.agent in (None, file.stem)]
    if not chosen:
        names = ", ".join(file.stem for file in files) or "nobody"
        raise FailedError(f"{args.agent or 'nobody'} wrote nothing in {folder} ({names} did)")
    for stamp, name, text in sorted(_lines(chosen), key=lambda line: line[0]):
        found = {"time": stamp, "agent": name, "text": text}
        print(json.dumps(found) if args.json else options.shown(text))
    return 0


def _newest() -> Path:
    """The folder of the last run on this machine. Raises FailedError."""
    there = Path(tempfile.gettempdir()).glob(FOLDERS)
    folders = [folder for folder in there if folder.is_dir() and any(folder.glob("*.log"))]
    if not folders:
        raise FailedError(
            "no run on this machine left its logs, and what was published is not kept;"
            " `armadico logs -f` shows what is logged from now on, `armadico record` keeps it"
        )
    return max(folders, key=lambda folder: folder.stat().st_mtime)


def _lines(files: Sequence[Path]) -> Iterator[tuple[str, str, str]]:
    """Each line with what it sorts by: the time of day, or that of the line before it."""
    for file in files:
        stamp = ""
        for line in file.read_text(encoding="utf-8", errors="replace").splitlines():
            first = line.partition(" ")[0]
            stamp = first if len(first) == 12 and first[2:3] == first[5:6] == ":" else stamp
            yield stamp, file.stem, line


main: Final = Command(
    "armadico logs",
    Options,
    run,
    "The agents' logs. Log lines are events: nobody keeps them, so -f shows what"
    " is logged from now on. Without -f it reads what the processes of a run on this machine"
    " wrote. `armadico record` keeps everything.",
    EXAMPLES,
)
