"""What the control page does on the mesh: what its parts declare."""

from __future__ import annotations

from armadico.core.guest import Guest, Part
from armadico.watch.page.model import capabilities
from armadico.watch.page.own import Goals, Parameters, StopLatch


class Page(Guest):
    """Observes, and passes on the requests of browsers."""

    reads = True

    @classmethod
    def parts(cls) -> tuple[type[Part], ...]:
        return (Goals, StopLatch, Parameters, *capabilities())
