"""Draw which agents publish and subscribe to which keys, from the cards of the alive agents."""

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
    dot: bool = flag("print Graphviz", either="how")
    mermaid: bool = flag("print a Mermaid flowchart", either="how")
    json: bool = flag("print a JSON object", either="how")
    mesh: options.Mesh = group(options.Mesh, "the mesh")


def run(args: Options) -> int:
    with args.mesh.client() as client:
        cards = client.cards()
    found = graph(card for card in cards.values() if card is not None)
    if not found.agents:
        raise AbsentError("no agent is alive", args.mesh.namespace)
    _write(args, found)
    silent = [name for (name, _), card in cards.items() if card is None]
    return options.answered([*silent, *args.mesh.lacks(cards)], "keys")


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
    """Agents and keys. Edges lead from a publisher to its key, and from a key to a subscriber.

    Of a query they lead from the client to the key and from the key to the server.
    """

    agents: list[str]
    keys: list[str]
    edges: frozenset[tuple[str, str]]


def graph(cards: Iterable[Card]) -> Graph:
    from armadico.core.services import Kind, services

    queries = {service.key for service in services() if service.kind is Kind.QUERY}
    agents: set[str] = set()
    edges: set[tuple[str, str]] = set()
    for card in cards:
        agents.add(card.name)
        sends = {key for key in card.provides if key not in queries}
        sends |= {key for key in card.requests if key in queries}
        receives = {*card.provides, *card.requests} - sends
        for name in card.resources:
            sends |= {*_keys_of(name)[:2]}  # while it holds the resource
        sends |= {_keys_of(name)[2] for name in card.owns}
        edges |= {(card.name, key) for key in sends} | {(key, card.name) for key in receives}
    edges = {(options.shown(a), options.shown(b)) for a, b in edges}
    agents = {options.shown(name) for name in agents}
    keys = {end for edge in edges for end in edge} - agents
    return Graph(sorted(agents), sorted(keys), frozenset(edges))


def _keys_of(resource: str) -> tuple[str, str, str]:
    """The keys of a resource's claims, commands and acknowledgements."""
    from armadico.core.resources import WHEELS

    own = f"resource/{resource}"
    commands = WHEELS.command_pattern if resource == WHEELS.name else f"{own}/cmd/*"
    return f"{own}/utility/*", commands, f"{own}/ack"


def text(found: Graph) -> str:
    """A line for each key: its publishers and its subscribers."""
    width = max(map(len, found.keys), default=0)
    edges, lines = sorted(found.edges), []
    for key in found.keys:
        publishers = ", ".join(a for a, b in edges if b == key) or "-"
        subscribers = ", ".join(b for a, b in edges if a == key) or "-"
        lines.append(f"{key:<{width}}  {publishers} -> {subscribers}")
    return "\n".join(lines)


def mermaid(found: Graph) -> str:
    """A Mermaid flowchart; agents have round boxes."""
    ids = {node: f"n{i}" for i, node in enumerate([*found.agents, *found.keys])}
    label = {node: node.replace('"', "#quot;") for node in ids}  # Mermaid's entity
    lines = ["flowchart LR"]
    lines += [f'  {ids[name]}(["{label[name]}"])' for name in found.agents]
    lines += [f'  {ids[key]}["{label[key]}"]' for key in found.keys]
    lines += [f"  {ids[a]} --> {ids[b]}" for a, b in sorted(found.edges)]
    return "\n".join(lines)


def dot(found: Graph) -> str:
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
    "Draw agents and keys, from the cards of the alive agents. The edges of a query lead from the"
    " client to the server. The exit code is 3 if an agent did not answer: its edges are missing.",
    EXAMPLES,
)
