"""The table of rights of a society's members: derived from installed classes, kept in a file.

The robot's router reads the file, because importing all agents takes seconds, and because their
packages need not be installed on the robot's computer.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

import msgspec

from armadico.core.config_errors import ConfigError
from armadico.core.discovery import AGENTS, agent_class
from armadico.core.errors import UnknownNameError
from armadico.core.guest import IDENTITIES, Guest
from armadico.core.individual import Individual
from armadico.core.installed import loaded
from armadico.keys import deriving
from armadico.keys.deriving import RightsError, Subject
from armadico.keys.rights import WORDS, Table
from armadico.keys.store import Member, Store, admits, write_private
from armadico.mesh.door import ROBOT
from armadico.mesh.sockets import stem

RIGHTS: Final = "rights.json"
"""The file, in the folder of the namespace's keys."""

DERIVE: Final = "`armadico keys rights --write` on the computer that has the authority's key"


def derive(members: Iterable[Member], namespace: str) -> Table:
    """Return the rights of a namespace's members by their classes, as they are installed here.

    Raises ConfigError for a member whose class is not installed here, or cannot be loaded, and for
    two members that cannot be told apart.
    """
    own = [member for member in members if member.namespace == namespace]
    try:
        return deriving.table([_with_classes(member) for member in own], _last(namespace))
    except RightsError as error:
        raise ConfigError(str(error)) from None


def file_of(store: Store, namespace: str) -> Path:
    return store.folder / stem(namespace) / RIGHTS


def save(store: Store, namespace: str, table: Table) -> None:
    """Write a namespace's table."""
    path = file_of(store, namespace)
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    write_private(path, msgspec.json.format(msgspec.json.encode(table), indent=1))


def derive_again(store: Store, namespace: str) -> Table:
    """Derive a namespace's table from the members and the classes, and write it."""
    table = derive(store.members().values(), namespace)
    save(store, namespace, table)
    return table


def load(store: Store, namespace: str) -> Table:
    """Read a namespace's table. Raises ConfigError with what to do."""
    path = file_of(store, namespace)
    try:
        return msgspec.json.decode(path.read_bytes(), type=Table)
    except OSError:
        raise ConfigError(
            f"the rights of {namespace} are missing: {DERIVE} makes them", path
        ) from None
    except msgspec.DecodeError as error:
        raise ConfigError(f"cannot be read: {error}; {DERIVE} writes it again", path) from None


def access_control(store: Store, namespace: str) -> dict[str, object]:
    """Return Zenoh's access control of a robot's router. Raises ConfigError."""
    members = store.members().values()
    admitted = {member.namespace for member in members if admits(member, namespace)}
    users = {_last(m.name): [*m.users] for m in members if m.namespace == namespace}
    table = load(store, namespace)
    return table.access_control(namespace, sorted(admitted - {namespace}), users)


def contradictions(stored: Table, derived: Table, among: Collection[str] = ()) -> Iterator[str]:
    """Yield how a stored table differs from the classes, one line for each identity.

    `among` limits it to these identities; by default to those of either table.
    """
    before, now = ({right[:3]: right for right in table.rights} for table in (stored, derived))
    for name in among or dict.fromkeys((*derived.speakers, *stored.speakers)):
        lacks = sorted(each for each in now.keys() - before.keys() if each[0] == name)
        surplus = sorted(each for each in before.keys() - now.keys() if each[0] == name)
        if name not in stored.speakers:
            yield f"{name} has no rights: its key was made after the table"
        elif name not in derived.speakers:
            yield f"{name} has rights, and is no member any more"
        elif lacks:
            right = now[lacks[0]]
            shown = f"{WORDS[right.does]} {right.key} ({right.because})"
            yield f"{name} lacks {_counted(lacks)}, such as {shown}"
        elif surplus:
            right = before[surplus[0]]
            yield (
                f"{name} has {_counted(surplus)} that its class does not declare, such as"
                f" {WORDS[right.does]} {right.key}"
            )
    agents = {agent for name in among for agent in derived.speakers[name]}
    critical = {each[:2] for each in stored.critical if not among or each.agent in agents}
    if critical != {each[:2] for each in derived.critical}:
        yield "the agents that may bid critical differ"


def doubts(store: Store, namespace: str, labels: Iterable[Sequence[str]]) -> Iterator[str]:
    """Yield how the stored rights of processes differ from the classes of their agents.

    And which of the files that the robot's router needs cannot be read, also without processes.
    """
    try:
        store.members_here()
    except ConfigError as error:
        yield str(error)
    try:
        stored = load(store, namespace)
        names = dict.fromkeys(store.of_agents(namespace, label) for label in labels)
        members = [
            Member(f"{namespace}/{name}", "agent", stored.speakers[name])
            for name in names
            if name in stored.speakers
        ]
        if not members:
            return
        now = derive(members, namespace)
    except ConfigError as error:
        yield str(error)
        return
    if members:
        yield from named(store, namespace, contradictions(stored, now, now.speakers))


def named(store: Store, namespace: str, found: Iterable[str]) -> Iterator[str]:
    """Yield the contradictions of a stored table, each with the file and what to do."""
    for line in found:
        yield (
            f"{file_of(store, namespace)} contradicts the classes: {line}; {DERIVE} writes it again"
        )


def _counted(rights: Sequence[object]) -> str:
    return "one right" if len(rights) == 1 else f"{len(rights)} rights"


def _with_classes(member: Member) -> Subject:
    name = member.name.rpartition("/")[2]
    if member.kind == "launcher":
        from armadico.agents.supervision.wakeup import Wakeup

        return Subject(name, {Wakeup.name: Wakeup})
    if member.kind in ("agent", ROBOT):
        return Subject(name, {agent: _agent(agent) for agent in member.agents})
    return Subject(name, {}, _guest(member))


def _agent(name: str) -> type[Individual]:
    try:
        return agent_class(name)
    except (UnknownNameError, ImportError) as error:
        raise ConfigError(
            f"no rights for the agent {name}: its class tells what it does, and {error}; install"
            f" its package here, where {AGENTS!r} has its entry point"
        ) from None


def _guest(member: Member) -> type[Guest]:
    guests: dict[str, type[Guest]] = {p.name: found for p, found in loaded(IDENTITIES, Guest)}
    return guests.get(member.kind, Guest)  # of a package that is not installed: no rights


def _last(namespace: str) -> str:
    return namespace.rpartition("/")[2]
