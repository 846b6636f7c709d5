"""Draw who says what to whom, from the cards of those who are there."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Final

from armadico.cli import options
from armadico.cli.options import FailedError

if TYPE_CHECKING:
    from armadico.core.messages import Card

EXAMPLES: Final = """\
  armadico graph                       a list: key, who says it, who listens
  armadico graph --svg graph.svg       a picture
  armadico graph --dot | dot -Tpdf > graph.pdf
"""

COLUMN, ROW, WIDTH, HEIGHT, EDGE = 250, 64, 190, 28, 24  # px
SWEEPS: Final = 8


def main(argv: Sequence[str]) -> int:
    """Draw."""
    made = options.parser(
        "armadico graph",
        "Agents and keys, drawn from the cards that those who are there give when asked. Queries"
        " go from who asks to who answers.",
        EXAMPLES,
    )
    how = made.add_mutually_exclusive_group()
    how.add_argument("--dot", action="store_true", help="for graphviz, on stdout")
    how.add_argument(
        "--svg", nargs="?", const="-", metavar="FILE", help="a picture, in a file or on stdout"
    )
    how.add_argument("--json", action="store_true", help="a JSON object on stdout")
    options.add_mesh_options(made)
    args = made.parse_args(argv)
    mesh = options.join(args)
    from armadico.runtime.client import Client  # noqa: PLC0415 - not for --help

    with mesh:
        cards = Client(mesh).cards()
    found = graph(card for card in cards.values() if card is not None)
    if not found.agents:
        raise options.nobody(args, "nobody is there")
    _write(args, found)
    return 0


def _write(args: argparse.Namespace, found: Graph) -> None:
    if args.svg is not None and args.svg != "-":
        try:
            Path(args.svg).write_text(svg(found), encoding="utf-8")
        except OSError as error:
            raise FailedError(f"cannot write {args.svg}: {error.strerror}") from None
        print(f"picture: {args.svg}", file=sys.stderr)
    elif args.svg is not None:
        print(svg(found))
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
    from armadico.core.services import SERVICES, Kind  # noqa: PLC0415 - not for --help

    queries = {service.key for service in SERVICES if service.kind is Kind.QUERY}
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
    from armadico.core.resources import WHEELS  # noqa: PLC0415 - not for --help

    own = f"resource/{resource}"
    commands = WHEELS.command_pattern if resource == WHEELS.name else f"{own}/cmd/*"
    return f"{own}/utility", commands, f"{own}/ack"


def text(found: Graph) -> str:
    """A line a key."""
    width = max(map(len, found.keys), default=0)
    return "\n".join(
        f"{key:<{width}}  {', '.join(found.says(key)) or '-'} -> "
        f"{', '.join(found.hears(key)) or '-'}"
        for key in found.keys
    )


def dot(found: Graph) -> str:
    """For graphviz."""
    lines = ["digraph armadico {", "  rankdir=LR;"]
    lines += [f"  {_quoted(name)} [shape=box, style=rounded];" for name in found.agents]
    lines += [f"  {_quoted(key)} [shape=plaintext];" for key in found.keys]
    lines += [f"  {_quoted(a)} -> {_quoted(b)};" for a, b in sorted(found.edges)]
    return "\n".join([*lines, "}"])


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


# The picture --------------------------------------------------------------------------------------


def layers(found: Graph) -> list[list[str]]:
    """Nodes in columns from left to right, along the flow of data.

    A column is the longest way from a beginning; edges that would close a circle do not count.
    """
    forward = _without_circles(found)
    depth = dict.fromkeys([*found.agents, *found.keys], 0)
    for _ in depth:  # as often as the longest way could have edges
        for a, b in forward:
            depth[b] = max(depth[b], depth[a] + 1)
    columns: list[list[str]] = [[] for _ in range(max(depth.values(), default=0) + 1)]
    for node in sorted(depth):
        columns[depth[node]].append(node)
    for _ in range(SWEEPS):
        _untangle(columns, found)
    return columns


def _without_circles(found: Graph) -> list[tuple[str, str]]:
    """The edges but those that lead back to a node whose followers are being visited.

    Those who share a resource both say and hear its key: there only the saying counts.
    """
    one_way = {(a, b) for a, b in found.edges if a in found.agents or (b, a) not in found.edges}
    after = {node: sorted(b for a, b in one_way if a == node) for node in _nodes(found)}
    kept: list[tuple[str, str]] = []
    visited: set[str] = set()
    open_: set[str] = set()

    def visit(node: str) -> None:
        visited.add(node)
        open_.add(node)
        for follower in after[node]:
            if follower not in open_:
                kept.append((node, follower))
                if follower not in visited:
                    visit(follower)
        open_.remove(node)

    for node in _nodes(found):
        if node not in visited:
            visit(node)
    return kept


def _nodes(found: Graph) -> list[str]:
    """Whoever publishes the cycles first: data begins with them."""
    from armadico.core.messages import RobotState  # noqa: PLC0415 - not for --help
    from armadico.core.services import service_of  # noqa: PLC0415 - not for --help

    cycles = service_of(RobotState).key
    nodes = [*found.agents, *found.keys]
    return sorted(nodes, key=lambda node: ((node, cycles) not in found.edges, node))


def _untangle(columns: list[list[str]], found: Graph) -> None:
    """Each node as near as can be to the middle of its neighbours."""
    height = {node: float(i) for column in columns for i, node in enumerate(column)}
    near: dict[str, list[str]] = {node: [] for node in height}
    for a, b in found.edges:
        near[a].append(b)
        near[b].append(a)
    for column in columns:
        column.sort(key=lambda n: (sum(height[m] for m in near[n]) / max(len(near[n]), 1), n))
        height.update({node: float(i) for i, node in enumerate(column)})


def svg(found: Graph) -> str:
    """A picture, with nothing but what is in the file."""
    columns = layers(found)
    rows = max(map(len, columns))
    place = {
        node: (
            EDGE + x * COLUMN,
            EDGE + (y + (rows - len(column)) / 2) * ROW,
        )
        for x, column in enumerate(columns)
        for y, node in enumerate(column)
    }
    width = 2 * EDGE + (len(columns) - 1) * COLUMN + WIDTH
    height = 2 * EDGE + (rows + 1) * ROW
    agents = set(found.agents)
    # Both ways between two is one line, with a tip at either end.
    shown = {(a, b) for a, b in found.edges if a in agents or (b, a) not in found.edges}
    edges = [_edge(place, height + ROW, a, b, both=(b, a) in found.edges) for a, b in sorted(shown)]
    nodes = [_node(place[node], node, is_agent=node in agents) for node in sorted(place)]
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height:.0f}"'
            f' viewBox="0 0 {width} {height:.0f}" font-family="sans-serif" font-size="13">',
            '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8"'
            ' markerHeight="8" orient="auto-start-reverse">'
            '<path d="M0,0 L8,4 L0,8 z" fill="#6b7883"/></marker></defs>',
            f'<rect width="{width}" height="{height:.0f}" fill="#ffffff"/>',
            *edges,
            *nodes,
            "</svg>",
        ]
    )


def _edge(
    place: Mapping[str, tuple[float, float]], bottom: float, a: str, b: str, *, both: bool
) -> str:
    """A curve; dashed, and below everything, where it leads back to the left."""
    (x1, y1), (x2, y2) = place[a], place[b]
    x1, y1, y2 = x1 + WIDTH, y1 + HEIGHT / 2, y2 + HEIGHT / 2
    back = x2 < x1
    bend, turn1, turn2 = (90.0, bottom, bottom) if back else ((x2 - x1) / 2, y1, y2)
    dash = ' stroke-dasharray="4 4" opacity="0.55"' if back else ""
    start = ' marker-start="url(#tip)"' if both else ""
    return (
        f'<path d="M{x1:.0f},{y1:.0f} C{x1 + bend:.0f},{turn1:.0f} {x2 - bend:.0f},{turn2:.0f}'
        f' {x2:.0f},{y2:.0f}" fill="none" stroke="#6b7883" marker-end="url(#tip)"{start}{dash}/>'
    )


def _node(at: tuple[float, float], name: str, *, is_agent: bool) -> str:
    x, y = at
    fill, ink, round_ = ("#22303c", "#ffffff", 14) if is_agent else ("#f4f7f9", "#22303c", 3)
    return (
        f'<rect x="{x}" y="{y:.0f}" width="{WIDTH}" height="{HEIGHT}" rx="{round_}" fill="{fill}"'
        f' stroke="#6b7883"/><text x="{x + WIDTH / 2}" y="{y + HEIGHT / 2 + 5:.0f}"'
        f' text-anchor="middle" fill="{ink}">{escape(name)}</text>'
    )
