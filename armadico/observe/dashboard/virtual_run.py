"""A run on the virtual mesh, drawn into a recording: for pictures and tests, in seconds."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from armadico.config.worlds import load_world
from armadico.core.messages import Message
from armadico.mesh.virtual import VirtualMesh
from armadico.observe.dashboard.local_map import Zones
from armadico.observe.dashboard.scene import SHOWN, Scene
from armadico.observe.dashboard.server import finish, keep

ASK_S: Final = 1.0
"""How often agents are asked for their cards and bids, as the live dashboard does."""


class Rehearsed:
    """Draws what happens on a virtual mesh, in a world; use as a context manager around its run."""

    def __init__(
        self,
        mesh: VirtualMesh,
        world: str,
        path: Path,
        zones: Zones,
        *,
        namespace: str = "robot1",
        graph: bool = False,
    ) -> None:
        walls = load_world(world)
        self._path = path
        self.recording = keep({namespace: walls}, path, graph=graph)
        self.scene = Scene(self.recording, walls, namespace, zones)
        self._mesh = mesh
        self._mesh.watch(self._take, *SHOWN)
        self._mesh.call_at(self._mesh.now + ASK_S, lambda _a, _b: self._ask())

    def __enter__(self) -> Rehearsed:
        return self

    def __exit__(self, *_: object) -> None:
        self._ask()
        finish(self.recording, self._path)

    def _take(self, key: str, message: Message, now: float) -> None:
        self.scene.take(key, message, now)

    def _ask(self) -> None:
        """Everybody's card and bids, once a second, without being heard."""
        now = self._mesh.now
        for node in self._mesh.nodes:
            agent = node.agent
            self.scene.alive(agent.instance, node.alive, now)
            if node.alive and not node.hung:
                self.scene.take("", agent.card(), now)
                self.scene.take("", agent.history(), now)
        self._mesh.call_at(now + ASK_S, lambda _a, _b: self._ask())
