"""What a rule is."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

from armadico.core.judgement import Answer
from armadico.core.messages import Message
from armadico.observe.audit.promises import Finding, Promise
from armadico.observe.audit.scene import Scene


class Rule:
    """Watches one promise.

    Attributes:
        promise: The promise.
        needs: Messages without which nothing is known of it.
        sees: Further messages that it uses.
        checked: Whether there was an occasion to break the promise.
    """

    promise: ClassVar[Promise]
    needs: ClassVar[tuple[type[Message], ...]] = ()
    sees: ClassVar[tuple[type[Message], ...]] = ()

    def __init__(self) -> None:
        self.checked = False

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
