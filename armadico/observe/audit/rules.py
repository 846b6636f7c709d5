"""What a rule is."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from typing import ClassVar, Final

from armadico.core.judgement import Answer
from armadico.core.messages import Message
from armadico.observe.audit.promises import Finding, Promise
from armadico.observe.audit.scene import Scene

AGAIN_S: Final = 10.0
"""What goes on is found again after this time, s."""


class Rule:
    """Watches one promise.

    Attributes:
        promise: The promise.
        needs: Messages without which nothing is known of it.
        sees: Further messages that it uses.
        charted: Whether it needs the map (`Scene.chart`).
        checked: Whether there was an occasion to break the promise.
        due: Whether the last occasion should have been judged by now, but for excuses.
    """

    promise: ClassVar[Promise]
    needs: ClassVar[tuple[type[Message], ...]] = ()
    sees: ClassVar[tuple[type[Message], ...]] = ()
    charted: ClassVar[bool] = False

    def __init__(self) -> None:
        self.checked = self.due = False
        self._found_at: dict[str, float] = {}  # the newest finding's time, s, by what it is of

    @property
    def pending(self) -> str:
        """Why the last occasion is not judged yet; "" if it is."""
        return ""

    def is_new(self, of: str, now: Scene, within_s: float = inf) -> bool:
        """Whether there was no finding of an agent or sensor within a time, s; now there is."""
        new = of not in self._found_at or now.now - self._found_at[of] > within_s
        if new:
            self._found_at[of] = now.now
        return new

    def on_message(self, message: Message, now: Scene) -> Iterator[Finding]:  # noqa: ARG002
        """Findings by a message, after the scene was updated with it."""
        yield from ()

    def on_time(self, now: Scene) -> Iterator[Finding]:  # noqa: ARG002
        """Findings as time passes without a message."""
        yield from ()

    def found(
        self, now: Scene, who: str, what: str, evidence: str = "", answer: Answer = Answer.NO
    ) -> Finding:
        return Finding(self.promise, now.now, who, what, evidence, answer)
