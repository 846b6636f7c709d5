"""Recording of a run on the virtual mesh, as `armadico record` does for a live one.

Journals do not pass through the mesh, so a run is the same whether it is recorded or not.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Final

from armadico.config.worlds import World
from armadico.core.messages import Ask, JournalPiece, Message, encode
from armadico.core.services import BIDS, CARD, service_of, services
from armadico.mesh.virtual import VirtualMesh
from armadico.observe.journals import head
from armadico.observe.translators import translators
from armadico.observe.watching import QUERY_S, Presence, Received
from armadico.watch.recorder import Recording

# Time 0 of the virtual clock, s since 1970 (September 2001): in ROS a stamp of 0 is invalid.
BEGUN: Final = 1_000_000_000


class Recorded:
    """Records a virtual mesh; use as a context manager around its run."""

    def __init__(
        self, mesh: VirtualMesh, path: Path, *namespaces: str, world: World | None = None
    ) -> None:
        """Create a new file for these robots, with a map. Raises OSError."""
        self._mesh, self._namespaces = mesh, namespaces
        self._failure: OSError | None = None
        about = {"namespaces": " ".join(namespaces), "seed": str(mesh.seed)}
        made = translators(namespaces, dict.fromkeys(namespaces, world))
        self.recording = Recording(path, about, translators=made)
        kinds = dict.fromkeys(each.message for each in services() if each.message is not Ask)
        for name in namespaces:
            mesh.watch(partial(self._write_message, name), *kinds, namespace=name)
        mesh.keep_journals(head)
        self._sample()

    def __enter__(self) -> Recorded:
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file. Raises OSError if the run could not be written completely."""
        with self._catch_failure():
            self._write_journals()
        with self._catch_failure():
            self.recording.close()
        if (failure := self._failure) is not None:
            what = f"is incomplete: {failure.strerror or failure}"
            raise OSError(failure.errno, what, str(self.recording.path)) from failure

    @contextmanager
    def _catch_failure(self) -> Iterator[None]:
        """Store an OSError until the end; the run continues without being recorded."""
        try:
            yield
        except OSError as error:
            self._failure = self._failure or error

    def _sample(self) -> None:
        """Write live agents, cards and bids once per second, without messages on the mesh."""
        now = self._mesh.now
        self._mesh.call_at(now + QUERY_S, lambda _a, _b: self._sample())
        with self._catch_failure():
            self._write_all(now)

    def _write_all(self, now: float) -> None:
        for node in self._mesh.nodes:
            where = node.namespace
            if where not in self._namespaces:
                continue
            agent = node.agent
            here = Presence(where, agent.name, agent.instance, node.alive, _ns(now))
            self._write(here)
            if node.alive and not node.hung:
                names = {"name": agent.name, "instance": agent.instance}
                self._write_message(
                    where, CARD.key_for(**names), agent.kernel.card(), now, on_query=True
                )
                self._write_message(
                    where, BIDS.key_for(**names), agent.kernel.history(), now, on_query=True
                )
        self._write_journals()
        if self._failure is None:
            self.recording.flush()

    def _write_journals(self) -> None:
        for node in self._mesh.nodes:
            for piece in node.pieces() if node.namespace in self._namespaces else ():
                key = service_of(JournalPiece).key_for(instance=piece.instance)
                self._write_message(node.namespace, key, piece, self._mesh.now)

    def _write_message(
        self, namespace: str, key: str, message: Message, now: float, *, on_query: bool = False
    ) -> None:
        data = encode(message)
        self._write(Received(namespace, key, data, _ns(now), on_query))

    def _write(self, item: Received | Presence) -> None:
        if self._failure is None:
            with self._catch_failure():
                self.recording.add(item)


def _ns(now: float) -> int:
    return BEGUN * 1_000_000_000 + round(1e9 * now)
