"""Make the key of an agent, or of agents that share a process."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from armadico.cli.parsing import Command, argument, group, option
from armadico.keys.commands.common import (
    OUT_HELP,
    Society,
    given_out,
    hours_option,
    issuer_of,
)

EXAMPLES: Final = """\
  armadico keys agent wander                     an agent that is not in the table
  armadico keys agent goto avoid                 agents that share a process
  armadico keys agent goto --out goto-keys.tar   for another computer
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    names: tuple[str, ...] = argument(
        "the agent; several share a process", nargs="+", metavar="NAME"
    )
    out: Path | None = option(f"{OUT_HELP} this computer's folder)", metavar="FILE")
    hours: float = hours_option()
    society: Society = group(Society, "the society")


def run(args: Options) -> int:
    from armadico.core.config_errors import ConfigError
    from armadico.core.discovery import AGENTS, find
    from armadico.core.errors import UnknownNameError
    from armadico.keys.members import of_agents

    for name in args.names:
        try:
            find(AGENTS, name)
        except UnknownNameError as error:
            raise ConfigError(
                f"{error}; rights are derived from a class, so install a package here that declares"
                f" {name} under {AGENTS!r}, also for a program in another language"
                " (docs/other-language.md)"
            ) from None
    issuer = issuer_of(args.society, args.hours)
    member = of_agents(args.society.where.namespace, args.names)
    given_out(issuer, (member,), args.out, args.society)
    return 0


COMMAND: Final = Command(
    "armadico keys agent",
    Options,
    run,
    "Make the key of an agent that no host of the table runs, or of agents that share a process."
    " The robot admits it once it has read the new list of identities.",
    EXAMPLES,
)
