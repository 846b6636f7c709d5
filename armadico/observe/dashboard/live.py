"""From the mesh to the scenes, on one thread.

A guest on the mesh: it has no token and answers nothing. Agents publish with congestion control
DROP, so what it does not read in time is discarded at its own link and no agent waits for it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Final

from armadico.core.resources import WHEELS
from armadico.core.services import service_of
from armadico.mesh.zenoh import ZenohMesh
from armadico.observe.dashboard.scene import SHOWN, Scene
from armadico.observe.watching import ASK_S, Heard, Watcher, read_or_none

ANSWER_S: Final = 0.8
"""Timeout of an answer: less than `ASK_S`, so that questions do not pile up."""

TURN_S: Final = 0.25
"""How often the loop checks whether to end, and draws what changes with time."""

WAITING: Final = 2000
"""Messages that may wait to be drawn: about 10 s of one robot."""

ALONE_S: Final = 10.0
"""Without a robot for this long, the user is told."""


class Live:
    def __init__(
        self, meshes: Sequence[ZenohMesh], scenes: Sequence[Scene], warn: Callable[[str], None]
    ) -> None:
        """Subscribe; the meshes are open, a scene belongs to each; `warn` is given lines."""
        self._scenes = {mesh.namespace: s for mesh, s in zip(meshes, scenes, strict=True)}
        self._watcher = Watcher(meshes, WAITING)
        self._began = self._watcher.clock()
        self._warn = warn
        self._stopping = False
        self._alone: set[str] = set()
        self._dropped = 0
        for kind in SHOWN:
            self._watcher.subscribe(service_of(kind).pattern)

    def stop(self) -> None:
        """Have `run` return soon; may be called from a signal handler or another thread."""
        self._stopping = True

    def run(self, ended: Callable[[], bool] = lambda: False) -> None:
        """Draw what is received until `stop`, or until `ended` is true (checked each `TURN_S`)."""
        ask_at = turn_at = time.monotonic()
        while not self._stopping:
            heard = self._watcher.get(TURN_S)
            at = self._watcher.clock() if heard is None else heard.at
            t = (at - self._began) / 1e9
            message = read_or_none(heard) if isinstance(heard, Heard) else None
            if heard is not None and message is not None:
                self._scenes[heard.namespace].update(message, t)
            now = time.monotonic()
            if now >= ask_at:
                ask_at = now + ASK_S
                self._watcher.ask_for_bids(ANSWER_S)
            if now >= turn_at:
                turn_at = now + TURN_S
                if ended():
                    return
                self._turn(t)

    def _turn(self, t: float) -> None:
        """Draw what changes with time; report losses and missing robots once each.

        The time is the last message's: by the clock, messages that still wait would be overdue.
        """
        for scene in self._scenes.values():
            scene.refresh(t)
        if self._watcher.dropped > self._dropped:
            self._warn(f"too slow: {self._watcher.dropped - self._dropped} messages were left out")
            self._dropped = self._watcher.dropped
        if t < ALONE_S:
            return
        # A mesh without a robot agent reports that itself.
        joined = [mesh.namespace for mesh in self._watcher.meshes if mesh.wait_joined(0.0)]
        alone = {ns for ns in joined if WHEELS.name not in self._scenes[ns].view.acks}
        for namespace in sorted(alone - self._alone):
            self._warn(
                f"no robot in namespace {namespace!r}; waiting for one (`armadico ps` lists alive"
                " agents, --namespace and --connect select where to look)"
            )
        self._alone = alone
