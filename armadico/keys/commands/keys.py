"""Make, list, check, renew and revoke the keys of a society."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Final

from armadico.cli import parsing
from armadico.cli.parsing import ArgumentParser, UsageError
from armadico.core.errors import UnknownNameError

EXAMPLES: Final = """\
  armadico keys init --hosts lab.toml     on the robot's computer, or another one
  armadico keys host lab2                 there: lab2-keys.tar, for the host lab2 of the table
  armadico keys revoke lab2               what the computer lab2 has gets no link any more
  armadico keys VERB --help               the options of each
"""

VERBS: Final = {
    "init": "make the authority of a lab, and the keys of this computer",
    "host": "write an archive with the keys of a host of the table",
    "agent": "make the key of an agent, or of agents that share a process",
    "person": "make the key of a person, who may drive, stop and release",
    "client": "make the key of a program or language model, for `armadico mcp --client`",
    "list": "list every identity, and until when it is valid",
    "check": "print what is wrong with the keys of this computer",
    "renew": "renew the certificates of this computer",
    "rights": "print what each identity may do, and why",
    "revoke": "revoke identities",
}
"""Each is a module beside this one, but `GIVING` are in one."""

GIVING: Final = ("host", "agent", "person", "client")


def main(argv: Sequence[str]) -> int:
    """Run a verb. Raises UnknownNameError for another one."""
    words = list(argv)
    if not words or words[0].startswith("-"):
        parser().parse_args(words)
        raise UsageError(f"name a verb, of {', '.join(VERBS)}; `armadico keys --help` has more")
    if words[0] not in VERBS:
        raise UnknownNameError("verb of `armadico keys`", words[0], VERBS)
    if words[0] in GIVING:
        from armadico.keys.commands.give import COMMANDS

        return int(COMMANDS[words[0]](words[1:]))
    verb = import_module(f"armadico.keys.commands.{words[0]}")
    return int(verb.COMMAND(words[1:]))


def parser() -> ArgumentParser:
    lines = [f"  {name:<8} {summary}\n" for name, summary in VERBS.items()]
    text = (
        "Make, list, check, renew and revoke keys: the identities by which processes join a society"
        ' whose host table has keys = "FOLDER".\n\nverbs:\n' + "".join(lines)
    )
    made = parsing.parser("armadico keys", text, EXAMPLES)
    made.add_argument("verb", choices=tuple(VERBS), metavar="VERB", help="see above", nargs="?")
    return made
