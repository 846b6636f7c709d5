"""The auditor within a society: what it found lately, for the monitor's report."""

from __future__ import annotations

from typing import ClassVar, Final

from armadico.config.worlds import is_map, load_world
from armadico.core.config_errors import ConfigError
from armadico.core.judgement import Answer
from armadico.core.messages import Card, Command, Message, line
from armadico.core.services import service_of
from armadico.observe.audit.auditor import Auditor, watched
from armadico.observe.audit.promises import Finding, Promise

KEPT_S: Final = 60.0
"""A broken promise is reported for so long, s."""

MOST: Final = 8
"""Most broken promises in a report; the newest come first."""


def learn(auditor: Auditor, card: Card) -> None:
    """Give an auditor the map that an agent was launched with, if it is a shipped one."""
    if not card.world:
        auditor.scene.mapped = bool(auditor.scene.mapped)
    elif not auditor.scene.mapped:
        try:
            world = load_world(card.world)
            same = is_map(world, card.map)  # else another map of that name
            auditor.chart(world.outlines if same else None, world if same else None)
        except ConfigError:
            auditor.chart(None)


class Live:
    """Judges the messages that one process receives.

    Attributes:
        kinds: The messages that it needs. A simulator's truth is for observers, not for agents, and
            the states say what was ordered.
        news: New findings that a promise is broken, until they are taken.
    """

    kinds: ClassVar[tuple[type[Message], ...]] = tuple(
        kind for kind in watched() if not service_of(kind).watchers_only and kind is not Command
    )

    def __init__(self, auditor: Auditor | None = None) -> None:
        self.news: list[str] = []
        self._broken: dict[tuple[Promise, str], Finding] = {}
        self._auditor = auditor or Auditor()
        self._auditor.scene.accuses = True

    def begin(self) -> None:
        """Forget all but findings and map: what this process did not receive proves nothing."""
        self._auditor = self._auditor.anew()

    def update(self, at: float, message: Message | None) -> None:
        """Judge a message at a time, s; or, with None, that time has passed."""
        auditor = self._auditor
        if isinstance(message, Card):
            learn(auditor, message)
            return
        found = auditor.tick(at) if message is None else auditor.update(at, "", message)
        auditor.findings.clear()
        for each in found:
            if each.answer is Answer.NO:
                self._broken[each.promise, each.who] = each
                self.news.append(line(str(each)))

    def broken(self, now: float) -> tuple[str, ...]:
        """What was broken lately, the newest first."""
        self._broken = {k: each for k, each in self._broken.items() if now - each.at <= KEPT_S}
        newest = sorted(self._broken.values(), key=lambda each: -each.at)
        return tuple(line(str(each)) for each in newest[:MOST])
