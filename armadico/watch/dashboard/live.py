"""The live dashboard: messages of the mesh are drawn into scenes, on one thread.

It has no liveliness token and answers no queries. Agents publish with congestion control DROP, so
messages that it does not read in time are discarded at its link, and no agent waits for it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Final

from armadico.core.resources import WHEELS
from armadico.core.services import service_of
from armadico.mesh.zenoh import ZenohMesh
from armadico.observe.watching import QUERY_S, Received, Watcher, read_or_none
from armadico.watch.dashboard.scene import SHOWN, Scene

ANSWER_S: Final = 0.8  # timeout of a query: less than QUERY_S, so that queries do not accumulate
TURN_S: Final = 0.25  # interval at which the loop checks for its end and removes stale items
WAITING: Final = 2000  # capacity of the queue of messages: about 10 s of one robot
ALONE_S: Final = 10.0  # time without a robot after which a warning is given


class Live:
    def __init__(
        self, meshes: Sequence[ZenohMesh], scenes: Sequence[Scene], warn: Callable[[str], None]
    ) -> None:
        """Subscribe on open meshes, with a scene for each; `warn` receives lines of text."""
        self._scenes = {mesh.namespace: s for mesh, s in zip(meshes, scenes, strict=True)}
        self._watcher = Watcher(meshes, WAITING)
        self._began = self._watcher.clock()
        self._warn = warn
        self._stopping = False
        self._alone: set[str] = set()
        self._dropped = 0
        for kind in SHOWN:
            self._watcher.subscribe(service_of(kind).heard)

    def stop(self) -> None:
        """Make `run` return soon; may be called from a signal handler or another thread."""
        self._stopping = True

    def run(self, ended: Callable[[], bool] = lambda: False) -> None:
        """Draw messages until `stop`, or until `ended` is true (checked each `TURN_S`)."""
        query_at = turn_at = time.monotonic()
        while not self._stopping:
            item = self._watcher.get(TURN_S)
            at = self._watcher.clock() if item is None else item.at
            t = (at - self._began) / 1e9
            message = read_or_none(item) if isinstance(item, Received) else None
            if item is not None and message is not None:
                self._scenes[item.namespace].update(message, t)
            now = time.monotonic()
            if now >= query_at:
                query_at = now + QUERY_S
                self._watcher.query_bids(ANSWER_S)
            if now >= turn_at:
                turn_at = now + TURN_S
                if ended():
                    return
                self._turn(t)

    def _turn(self, t: float) -> None:
        """Remove stale items; report losses and missing robots once each.

        `t` is the time of the last message: by the clock, waiting messages would seem stale.
        """
        for scene in self._scenes.values():
            scene.refresh(t)
        if self._watcher.dropped > self._dropped:
            self._warn(f"too slow: {self._watcher.dropped - self._dropped} messages were dropped")
            self._dropped = self._watcher.dropped
        if t < ALONE_S:
            return
        # A mesh without a robot agent reports that itself.
        joined = [mesh.namespace for mesh in self._watcher.meshes if mesh.wait_joined(0.0)]
        alone = {ns for ns in joined if WHEELS.name not in self._scenes[ns].view.acks}
        for namespace in sorted(alone - self._alone):
            self._warn(
                f"no robot in namespace {namespace!r}; waiting for one (`armadico ps` lists live"
                " agents; select another with --namespace or --connect)"
            )
        self._alone = alone
