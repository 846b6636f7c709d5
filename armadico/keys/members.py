"""The identities that a society needs, by its host table: values in, values out."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from armadico.config.hosts import HostTable
from armadico.config.slots import slot
from armadico.core.agent import DeviceAgent
from armadico.core.config_errors import ConfigError
from armadico.core.discovery import AGENTS, agent_class, installed, owners
from armadico.core.guest import IDENTITIES, Guest
from armadico.core.installed import loaded
from armadico.core.resources import WHEELS, Resource
from armadico.core.services import by_people
from armadico.keys.store import Member, name_in
from armadico.mesh.door import (
    CLIENT,
    LAUNCHER,
    MCP,
    PAGE,
    PERSON,
    ROBOT,
    ROS2,
    SIMULATOR,
    VIEWER,
    launcher,
    name_of,
    person,
)

GATEWAYS = (PAGE, MCP, ROS2, VIEWER)
"""Identities that each host of a table gets, besides those of its agents."""


def of_host(
    table: HostTable, name: str, namespace: str, persons: Sequence[str]
) -> tuple[Member, ...]:
    """The identities of one host: its processes, what it may take over, gateways and persons.

    Raises ConfigNameError for an unknown host.
    """
    host = table.host(name)
    group_of = {agent: group for group in host.together for agent in group}
    labels = dict.fromkeys(group_of.get(agent, (agent,)) for agent in host.agents)
    labels |= dict.fromkeys((agent,) for agent in _spare(table, name))
    found = [of_agents(namespace, label) for label in labels]
    if name == table.robots_host:
        found.append(Member(f"{namespace}/{SIMULATOR}", SIMULATOR))
    found.append(Member(f"{namespace}/{launcher(name)}", "launcher"))
    found += of_gateways(namespace)
    found += [of_person(namespace, user) for user in persons]
    return tuple({member.name: member for member in found}.values())


def of_table(
    table: HostTable, namespace: str, persons: Sequence[str]
) -> dict[str, tuple[Member, ...]]:
    """The identities of each host."""
    return {host: of_host(table, host, namespace, persons) for host in table.hosts}


def of_agents(namespace: str, agents: Sequence[str]) -> Member:
    """The identity of agents that share a process; with the robot agent it is the router's.

    Raises ConfigError for an agent with a name of another kind of identity.
    """
    for name in agents:
        taken = kind_of(name) != "agent" or by_people(name)
        if taken and WHEELS not in _owns(name):
            raise ConfigError(
                f"an agent called {name!r} could be taken for another process, as with keys the"
                f" name tells what it is; expected a name without {name.partition('-')[0]!r}"
            )
    if any(owners(agents, WHEELS)):
        return Member(f"{namespace}/{ROBOT}", ROBOT, tuple(agents))
    return Member(f"{namespace}/{name_of(agents)}", "agent", tuple(agents))


def _owns(name: str) -> Collection[Resource]:
    return agent_class(name).owns if name in installed(AGENTS) else ()


def of_gateways(namespace: str) -> list[Member]:
    return [Member(f"{namespace}/{each}", each) for each in GATEWAYS]


def of_person(namespace: str, user: str) -> Member:
    return Member(f"{namespace}/{person(user)}", "person")


def for_person(namespace: str, user: str) -> tuple[Member, ...]:
    """The identity of a person, and those of what runs beside a person's commands."""
    by_hand = (of_agents(namespace, (name,)) for name in slot("by-hand").besides)
    return (of_person(namespace, user), *of_gateways(namespace), *by_hand)


def of_client(namespace: str, name: str) -> Member:
    """The identity of a program that asks the assistant agent under a name of its own."""
    return Member(f"{namespace}/{CLIENT}{name}", MCP)


def kind_of(name: str) -> str:
    """The kind of an identity by its name, which no agent may have."""
    last = name_in(name).rpartition("/")[2]
    for prefix, kind in ((PERSON, "person"), (LAUNCHER, "launcher"), (CLIENT, MCP)):
        if last.startswith(prefix):
            return kind
    return last if last in (*GATEWAYS, ROBOT, SIMULATOR) else "agent"


def _spare(table: HostTable, name: str) -> Iterator[str]:
    """The agents that a host may start in place of a failed host, or beside a gateway."""
    host, here = table.host(name), installed(AGENTS)
    placed = dict.fromkeys(agent for other in table.hosts.values() for agent in other.agents)
    takes = [agent for agent in placed if host.takes is None or agent in host.takes]
    beside = [agent for _, guest in loaded(IDENTITIES, Guest) for agent in guest.starts]
    for agent in dict.fromkeys((*takes, *slot("by-hand").besides, *beside)):
        if agent in here and not issubclass(agent_class(agent), DeviceAgent):
            yield agent
