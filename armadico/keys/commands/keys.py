"""Make, list, check, renew and revoke the keys of a society."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from armadico.cli import parsing
from armadico.cli.parsing import ArgumentParser, UsageError
from armadico.core.errors import UnknownNameError

EXAMPLES: Final = """\
  armadico keys init --hosts lab.toml     make the lab's authority, and this computer's keys
  armadico keys host lab2                 write lab2-keys.tar, for the host lab2 of the table
  armadico keys person anna               for a person, who may drive, stop and release
  armadico keys agent goto                for an agent that is not in the table
  armadico keys list                      every identity, and until when it is valid
  armadico keys check                     what is wrong with the keys of this computer
  armadico keys rights                    what each identity may do, and why
  armadico keys renew                     new certificates for the keys of this computer
  armadico keys revoke lab2               no link any more for what lab2 has
  armadico keys VERB --help               the options of each
"""


@dataclass(frozen=True)
class Verb:
    """A verb, found as `module:COMMAND` when it is used."""

    module: str
    summary: str

    def load(self) -> Callable[[Sequence[str]], int]:
        from importlib import import_module

        found: Callable[[Sequence[str]], int] = import_module(self.module).COMMAND
        return found


def _verb(name: str, summary: str) -> Verb:
    return Verb(f"armadico.keys.commands.{name}", summary)


VERBS: Final = {
    "init": _verb("init", "make the authority of a lab, and the keys of this computer"),
    "host": _verb("host", "write an archive with the keys of a host of the table"),
    "agent": _verb("agent", "make the key of an agent, or of agents that share a process"),
    "person": _verb("person", "make the key of a person"),
    "list": _verb("list", "list all identities"),
    "check": _verb("check", "check the keys of this computer"),
    "renew": _verb("renew", "renew the certificates of this computer"),
    "rights": _verb("rights", "print what each identity may do, and why"),
    "revoke": _verb("revoke", "revoke identities"),
}


def main(argv: Sequence[str]) -> int:
    """Run a verb. Raises UnknownNameError for another one."""
    words = list(argv)
    if not words or words[0].startswith("-"):
        parser().parse_args(words)
        raise UsageError(f"name a verb, of {', '.join(VERBS)}; `armadico keys --help` has more")
    verb = VERBS.get(words[0])
    if verb is None:
        raise UnknownNameError("verb of `armadico keys`", words[0], VERBS)
    return verb.load()(words[1:])


def parser() -> ArgumentParser:
    lines = [f"  {name:<8} {verb.summary}\n" for name, verb in VERBS.items()]
    text = (
        "Make, list, check, renew and revoke keys: the identities by which processes join a society"
        ' whose host table has keys = "FOLDER".\n\nverbs:\n' + "".join(lines)
    )
    made = parsing.parser("armadico keys", text, EXAMPLES)
    made.add_argument("verb", choices=tuple(VERBS), metavar="VERB", help="see above", nargs="?")
    return made
