"""The command line: commands are found by name and imported when they are called.

A command is a module in the entry point group `armadico.commands`, of this or another package. The
first line of its docstring is its help, and its `main(arguments)` returns the exit code.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Final

from armadico.cli import options
from armadico.core.discovery import COMMANDS, find, installed
from armadico.core.errors import UnknownNameError

LABORATORY: Final = "armadico-tools"
"""The distribution of the development tools, which a robot's computer does not need."""

TOOLS: Final = (
    *("attacks", "bench", "campaign", "experiment", "falsify", "faults", "learn", "model-check"),
)
"""The commands of `LABORATORY`."""

ELSEWHERE: Final = {
    "status": "`armadico ps` lists the agents, `armadico top` shows the robot",
    "list": "`armadico ps` lists the agents, `armadico places` places",
    "nodes": "`armadico ps` lists the agents",
    "node": "`armadico ps` lists the agents",
    "start": "`armadico up` starts a society, `armadico run` a scenario",
    "launch": "`armadico up` starts a society, `armadico run` a scenario",
    "topics": "`armadico graph` lists who publishes what, `armadico echo KEY` shows messages",
    "topic": "`armadico graph` lists who publishes what, `armadico echo KEY` shows messages",
    "kill": "`armadico down` ends a society, `armadico stop` stops the robot",
    "param": "`armadico get` and `armadico set`",
    "bag": "`armadico record` and `armadico replay`",
}
"""Commands of other tools, for which the most similar name would mislead."""

GET: Final = "`make tools` in a checkout, or `pip install ./tools`"

EXAMPLES: Final = """\
  armadico run sc4              drive scenario 4 on this machine
  armadico ps                   list alive agents and held resources
  armadico goto 4 2 90          send the robot to x 4 m, y 2 m, heading 90 degrees
  armadico stop                 stop it
  armadico COMMAND --help       more about a command
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    return options.guarded("armadico", lambda: _dispatch(arguments))


def _dispatch(arguments: list[str]) -> int:
    if arguments[:1] == ["help"] and len(arguments) > 1:
        arguments = [arguments[1], "--help"]
    if not arguments or arguments[0] in {"-h", "--help", "help"}:
        print(_help(), end="")
        return 0 if arguments else 2
    name, *rest = arguments
    if name == "--version":
        print(f"armadico {options.version()}")
        return 0
    try:
        found = find(COMMANDS, name)
    except UnknownNameError as error:
        if name in ELSEWHERE:
            message = f"no command {name!r}; {ELSEWHERE[name]}"
            raise UnknownNameError("command", name, error.known, message) from None
        if name in TOOLS:
            message = f"{name!r} is a command of {LABORATORY}: install it with {GET}"
            raise UnknownNameError("command", name, (), message) from None
        raise
    command: Callable[[Sequence[str]], int] = found.load()
    return command(rest)


def _more() -> list[str]:
    """A line about the commands of `LABORATORY`, if it is not installed."""
    if any(found.package == LABORATORY for found in installed(COMMANDS).values()):
        return []
    return [f"{LABORATORY} has more ({GET}): {', '.join(TOOLS)}"]


def _help() -> str:
    commands = installed(COMMANDS)
    width = max((len(name) for name in commands), default=0) + 2
    rows = "\n".join(f"  {name:<{width}}{found.summary}" for name, found in commands.items())
    more = "".join(f"\n{line}\n" for line in _more())
    return (
        "usage: armadico COMMAND [OPTION]...\n\n"
        "One robot, many agents, nobody in charge.\n\n"
        f"commands:\n{rows}\n{more}\nexamples:\n{EXAMPLES}\n"
        "`armadico --version` prints the version; `armadico-agent` runs single agents.\n"
    )
