"""Alive agents by host, and from their cards a graph of publishers and subscribers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from statistics import fmean
from typing import Final

import rerun as rr

from armadico.core.messages import Ack, Card, Claim, Command
from armadico.core.services import service_at
from armadico.observe.dashboard import palette
from armadico.observe.dashboard.canvas import Canvas, Colour
from armadico.observe.view import View

COLUMN: Final = 330.0
ROW: Final = 42.0
"""Between the graph's columns and rows, in points of the screen at its natural size."""

WHY: Final = 40
"""Characters of a bid's reason that fit into the page."""

Edge = tuple[str, str]


class Company:
    """Draws one robot's society."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        self._graph: Graph | None = None

    def draw(self, view: View, holders: Mapping[str, str], t: float) -> None:
        """The page, each second, and the graph when it has changed."""
        if not self._canvas.due("society/table", t):
            return
        page = rr.TextDocument(_page(view, holders), media_type=rr.MediaType.MARKDOWN)
        self._canvas.draw("society/table", t, page)
        graph = Graph((agent.card for agent in view.agents if agent.card is not None), holders)
        if self._graph is None or not graph.looks_like(self._graph):
            self._graph = graph
            graph.draw(self._canvas, t)


def _page(view: View, holders: Mapping[str, str]) -> str:
    lines = ["| agent | host | pid | holds | bids | why |", "|---|---|---|---|---|---|"]
    for name, instance, card in view.agents:
        bid = view.bid(instance)
        holds = ", ".join(what for what, who in holders.items() if who == name)
        host, pid = (card.host, str(card.pid)) if card else ("?", "not answering")
        utility = "" if bid is None or bid.utility is None else f"{bid.utility:.2f}"
        why = "" if bid is None else bid.reason
        lines.append(f"| {name} | {host} | {pid} | {holds} | {utility} | {why[:WHY]} |")
    return "\n".join(lines) + "\n"


class Graph:
    """Three columns: publishers, keys, subscribers."""

    def __init__(self, cards: Iterable[Card], holders: Mapping[str, str]) -> None:
        self.places: dict[str, tuple[float, float]] = {}
        self.colours: dict[str, Colour] = {}
        self.edges: list[Edge] = []
        self._labels: dict[str, str] = {}
        by_name = {card.name: card for card in cards}
        for card in by_name.values():
            self._join(card)
        self._columns()
        for resource, holder in holders.items():
            if f"key/{resource}" in self.colours:
                self.colours[f"key/{resource}"] = palette.agent(holder)

    def looks_like(self, other: Graph) -> bool:
        """Whether it would be drawn the same."""
        same = self.places == other.places and self.colours == other.colours
        return same and set(self.edges) == set(other.edges)

    def draw(self, canvas: Canvas, t: float) -> None:
        """Nodes where they belong and arrows between them."""
        nodes = rr.GraphNodes(
            list(self.places),
            positions=list(self.places.values()),
            colors=[self.colours[node] for node in self.places],
            labels=[self._labels[node] for node in self.places],
            show_labels=True,
        )
        arrows = rr.GraphEdges(self.edges, graph_type="directed")
        canvas.draw("society/graph", t, nodes, arrows)

    def _join(self, card: Card) -> None:
        says = [*card.provides, *card.resources]
        hears = [*(key for key in card.requests if not _by_resource(key)), *card.owns]
        self.edges += [(f"says/{card.name}", f"key/{key}") for key in says]
        self.edges += [(f"key/{key}", f"hears/{card.name}") for key in hears]

    def _columns(self) -> None:
        """Publishers by name, keys beside their publishers, subscribers beside the keys."""
        said = {edge for edge in self.edges if edge[0].startswith("says/")}
        heard = set(self.edges) - said
        self._place(0, {node: 0.0 for node, _ in said})
        keys = {node: self._beside(node, said) for _, node in said}
        self._place(1, {node: 0.0 for node, _ in heard if node not in keys} | keys)
        self._place(2, {node: self._beside(node, heard) for _, node in heard})

    def _beside(self, node: str, edges: Iterable[Edge]) -> float:
        """The mean row of what leads to a node: there its arrows cross the fewest others."""
        return fmean(self.places[source][1] for source, target in edges if target == node)

    def _place(self, column: int, heights: Mapping[str, float]) -> None:
        listed = sorted(heights, key=lambda node: (heights[node], node))
        for row, node in enumerate(listed):
            role, _, name = node.partition("/")
            self.places[node] = (column * COLUMN, (row - (len(listed) - 1) / 2.0) * ROW)
            self.colours[node] = palette.WALL if role == "key" else palette.agent(name)
            self._labels[node] = name


def _by_resource(key: str) -> bool:
    """Whether the graph shows a key as the resource that it is about."""
    service = service_at(key)
    return service is not None and service.message in (Ack, Claim, Command)
