"""Give out keys: of a host, of a person, of an agent, or of a client program."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from armadico.cli.options import UsageError
from armadico.cli.parsing import Command, argument, group, option, several
from armadico.keys.commands.common import (
    OUT_HELP,
    Society,
    given_out,
    hours_option,
    issuer_of,
)
from armadico.mesh.door import CLIENT, LONGEST_NAME, PERSON, person

OF_HOST: Final = """\
  armadico keys host lab2 --hosts lab.toml
  scp lab2-keys.tar lab2:lab/ && ssh lab2 tar -xf lab/lab2-keys.tar -C lab
  armadico keys host lab2 --person anna --person ben    who uses that computer
  armadico keys host lab2 --out /media/stick/keys       a folder instead of an archive
"""

OF_PERSON: Final = """\
  armadico keys person anna                        on this computer
  armadico keys person anna --out anna-keys.tar    for a computer of hers
"""

OF_AGENT: Final = """\
  armadico keys agent wander                     an agent that is not in the table
  armadico keys agent goto avoid                 agents that share a process
  armadico keys agent goto --out goto-keys.tar   for another computer
"""


OF_CLIENT: Final = """\
  armadico keys client claude                          on this computer
  armadico keys client claude --out claude-keys.tar    for another user, or another computer
"""


@dataclass(frozen=True, kw_only=True)
class _Given:
    """What all but a host's keys have."""

    out: Path | None = option(f"{OUT_HELP} this computer's folder)", metavar="FILE")
    hours: float = hours_option()
    society: Society = group(Society, "the society")


@dataclass(frozen=True, kw_only=True)
class Host:
    name: str = argument("the host, as the host table names it", metavar="NAME")
    out: Path | None = option(
        f"{OUT_HELP} NAME-keys.tar; of this computer: its folder)", metavar="FILE"
    )
    person: tuple[str, ...] = several(
        "include the key of this person; may be repeated (default: the user of this command)",
        metavar="USER",
    )
    hours: float = hours_option()
    society: Society = group(Society, "the society")


def host(args: Host) -> int:
    from armadico.keys.members import of_host

    table, where, users = args.society.table, args.society.where, args.person
    issuer = issuer_of(args.society, args.hours)
    members = of_host(table, args.name, where.namespace, args.society.users(users))
    here = args.out is None and args.name == where.name
    file = None if here else args.out or Path(f"{args.name}-keys.tar")
    given_out(issuer, members, args.name, file, args.society)
    return 0


@dataclass(frozen=True, kw_only=True)
class Person(_Given):
    user: str = argument("the name with which the person logs in", metavar="USER")


def of_person(args: Person) -> int:
    from armadico.keys.members import for_person

    _check(PERSON, args.user, "a user's name")
    issuer, namespace = issuer_of(args.society, args.hours), args.society.where.namespace
    members = for_person(namespace, args.user)
    given_out(issuer, members, person(args.user), args.out, args.society)
    return 0


@dataclass(frozen=True, kw_only=True)
class Client(_Given):
    name: str = argument("the program, as its policy and the log call it", metavar="NAME")


def of_client(args: Client) -> int:
    from armadico.keys.members import of_client as member_of

    _check(CLIENT, args.name, "a name")
    issuer, namespace = issuer_of(args.society, args.hours), args.society.where.namespace
    member = member_of(namespace, args.name)
    last = member.name.rpartition("/")[2]
    given_out(issuer, (member,), last, args.out, args.society)
    print(f'in a policy: [clients."{last}"]')
    return 0


@dataclass(frozen=True, kw_only=True)
class Agent(_Given):
    names: tuple[str, ...] = argument(
        "the agent; several share a process", nargs="+", metavar="NAME"
    )


def agent(args: Agent) -> int:
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
    given_out(issuer, (member,), member.name.rpartition("/")[2], args.out, args.society)
    return 0


def _check(kind: str, name: str, what: str) -> None:
    """Raise UsageError for a name that an identity of a kind cannot have."""
    most = LONGEST_NAME - len(kind)
    if not re.fullmatch(f"[A-Za-z0-9_.-]{{1,{most}}}", name):
        raise UsageError(
            f"{name!r}: expected {what} of letters, digits, '.', '_' and '-', at most {most}"
        )


COMMANDS: Final[dict[str, Command[Any]]] = {
    "host": Command(
        "armadico keys host",
        Host,
        host,
        "Write the keys of one host of the table: of its agents, of those that it may take over, of"
        " `armadico up`, the page and its persons. Unpack the archive beside the host table on that"
        " computer. It has no key of the authority, and of another host's agents only those that"
        " this host may take over (`takes`). Unpack it soon: its certificates expire as all"
        " others.",
        OF_HOST,
    ),
    "person": Command(
        "armadico keys person",
        Person,
        of_person,
        "Make the key of a person, who may look, drive, stop and release, and the keys of what runs"
        " beside a command: the page, the gateways and the agent for driving by hand.",
        OF_PERSON,
    ),
    "client": Command(
        "armadico keys client",
        Client,
        of_client,
        "Make the key of one program or language model, which joins by `armadico mcp --client"
        " NAME`. The robot's router lets no other program ask as it, so a policy can rely on it.",
        OF_CLIENT,
    ),
    "agent": Command(
        "armadico keys agent",
        Agent,
        agent,
        "Make the key of an agent that no host of the table runs, or of agents that share a"
        " process. The robot admits it once it has read the new list of identities.",
        OF_AGENT,
    ),
}
