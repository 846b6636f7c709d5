"""A run on the virtual mesh, drawn into a recording, for pictures and tests."""

from __future__ import annotations

from pathlib import Path

from armadico.config.worlds import load_world
from armadico.mesh.topology import DEFAULT_NAMESPACE
from armadico.mesh.virtual import VirtualMesh
from armadico.observe.watching import QUERY_S
from armadico.watch.dashboard.local_map import Zones
from armadico.watch.dashboard.scene import SHOWN, Scene
from armadico.watch.dashboard.server import finish, keep


class Rehearsed:
    """Draws a run on a virtual mesh; use as a context manager around it."""

    def __init__(self, mesh: VirtualMesh, world: str, path: Path, zones: Zones) -> None:
        walls = load_world(world)
        self._path = path
        self._recording = keep({DEFAULT_NAMESPACE: walls}, path)
        self._scene = Scene(self._recording, walls, DEFAULT_NAMESPACE, zones)
        self._mesh = mesh
        mesh.watch(lambda _key, message, now: self._scene.update(message, now), *SHOWN)
        mesh.call_at(mesh.now + QUERY_S, self._query)

    def __enter__(self) -> Rehearsed:
        return self

    def __exit__(self, *_: object) -> None:
        self._query()
        finish(self._recording, self._path)

    def _query(self, *_: object) -> None:
        """Read each agent's recent bids once per second, without a message on the mesh."""
        for node in self._mesh.nodes:
            if node.alive and not node.hung:
                self._scene.update(node.agent.kernel.history(), self._mesh.now)
        self._mesh.call_at(self._mesh.now + QUERY_S, self._query)
