"""Draw which agent publishes what to whom, from the cards of the agents that are alive."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.parsing import Command, flag, group
from armadico.runtime.errors import AbsentError

if TYPE_CHECKING:
    from armadico.core.messages import Card

EXAMPLES: Final = """\
  armadico graph                       a list: key, publishers -> subscribers
  armadico graph --mermaid             for a Markdown page, or mermaid.live
  armadico graph --dot | dot -Tsvg > graph.svg
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    dot: bool = flag("for Graphviz, on stdout", either="how")
    mermaid: bool = flag("a Mermaid flowchart, on stdout", either="how")
    json: bool = flag("a JSON object on stdout", either="how")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    with args.mesh.client() as client:
        cards = client.cards()
    found = graph(card for card in cards.values() if card is not None)
    if not found.agents:
        raise AbsentError("no agent is alive", args.mesh.namespace)
    _write(args, found)
    return 0


def _write(args: Options, found: Graph) -> None:
    if args.mermaid:
        print(mermaid(found))
    elif args.dot:
        print(dot(found))
    elif args.json:
        edges = [list(edge) for edge in sorted(found.edges)]
        print(json.dumps({"agents": found.agents, "keys": found.keys, "edges": edges}, indent=2))
    else:
        print(text(found))


@dataclass(frozen=True)
class Graph:
    """Agents and keys; an edge goes from who says something to its key, or from key to hearer."""

    agents: list[str]
    keys: list[str]
    edges: frozenset[tuple[str, str]]

    def says(self, key: str) -> list[str]:
        """Who publishes, or asks."""
        return sorted(a for a, b in self.edges if b == key)

    def hears(self, key: str) -> list[str]:
        """Who listens, or answers."""
        return sorted(b for a, b in self.edges if a == key)


def graph(cards: Iterable[Card]) -> Graph:
    """The graph of those who have these cards."""
    from armadico.core.services import Kind, services

    queries = {service.key for service in services() if service.kind is Kind.QUERY}
    agents: set[str] = set()
    edges: set[tuple[str, str]] = set()
    for card in cards:
        agents.add(card.name)
        says = {key for key in card.provides if key not in queries}
        says |= {key for key in card.requests if key in queries}
        hears = {*card.provides, *card.requests} - says
        for name in card.resources:
            says |= {*_keys_of(name)[:2]}  # whoever holds it
        says |= {_keys_of(name)[2] for name in card.owns}
        edges |= {(card.name, key) for key in says} | {(key, card.name) for key in hears}
    edges = {(options.shown(a), options.shown(b)) for a, b in edges}
    agents = {options.shown(name) for name in agents}
    keys = {end for edge in edges for end in edge} - agents
    return Graph(sorted(agents), sorted(keys), frozenset(edges))


def _keys_of(resource: str) -> tuple[str, str, str]:
    """Where a resource's claims, commands and acknowledgements travel."""
    from armadico.core.resources import WHEELS

    own = f"resource/{resource}"
    commands = WHEELS.command_pattern if resource == WHEELS.name else f"{own}/cmd/*"
    return f"{own}/utility", commands, f"{own}/ack"


def text(found: Graph) -> str:
    width = max(map(len, found.keys), default=0)
    return "\n".join(
        f"{key:<{width}}  {', '.join(found.says(key)) or '-'} -> "
        f"{', '.join(found.hears(key)) or '-'}"
        for key in found.keys
    )


def mermaid(found: Graph) -> str:
    """A Mermaid flowchart; agents are rounded."""
    ids = {node: f"n{i}" for i, node in enumerate([*found.agents, *found.keys])}
    label = {node: node.replace('"', "#quot;") for node in ids}  # Mermaid's entity
    lines = ["flowchart LR"]
    lines += [f'  {ids[name]}(["{label[name]}"])' for name in found.agents]
    lines += [f'  {ids[key]}["{label[key]}"]' for key in found.keys]
    lines += [f"  {ids[a]} --> {ids[b]}" for a, b in sorted(found.edges)]
    return "\n".join(lines)


def dot(found: Graph) -> str:
    """For Graphviz."""
    lines = ["digraph armadico {", "  rankdir=LR;"]
    lines += [f"  {_quoted(name)} [shape=box, style=rounded];" for name in found.agents]
    lines += [f"  {_quoted(key)} [shape=plaintext];" for key in found.keys]
    lines += [f"  {_quoted(a)} -> {_quoted(b)};" for a, b in sorted(found.edges)]
    return "\n".join([*lines, "}"])


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


main: Final = Command(
    "armadico graph",
    Options,
    run,
    "Agents and keys, from the cards of the agents that are alive. A query's edges go from who"
    " asks to who answers.",
    EXAMPLES,
)
