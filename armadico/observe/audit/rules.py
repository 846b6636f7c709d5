"""What a rule is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from math import inf
from typing import ClassVar, Final

from armadico.core.judgement import Answer
from armadico.core.messages import Message
from armadico.core.names import handler_name
from armadico.observe.audit.promises import Finding, Promise
from armadico.observe.audit.scene import Scene

AGAIN_S: Final = 10.0
"""What goes on is found again after this time, s."""

MISSING: Final = 0.2
"""If more of the robot's states than this share are missing, nothing counts as kept. A speed,
a stop or a change of the agent that drives may lie between the others. If others that come each
cycle, or commands, are, what needs them does not."""

Handler = Callable[[Message, Scene], Iterable[Finding] | None]


class Rule:
    """Watches one promise.

    Its method `on_<message>`, such as `on_robot_state`, receives each message of that kind or of
    one that derives from it, and the scene, which was updated with it before. It returns findings
    or None.

    Attributes:
        promise: The promise.
        needs: Messages without which nothing is known of it.
        sees: Further messages that it uses.
        charted: Whether it needs the map (`Scene.chart`).
        checked: Whether there was an occasion to break the promise.
    """

    promise: ClassVar[Promise]
    needs: ClassVar[tuple[type[Message], ...]] = ()
    sees: ClassVar[tuple[type[Message], ...]] = ()
    charted: ClassVar[bool] = False

    def __init__(self) -> None:
        self.checked = False
        self._found_at: dict[str, float] = {}  # the newest finding's time, s, by what it is of

    @property
    def pending(self) -> str:
        """Why the last occasion is not judged yet; "" if it is."""
        return ""

    @property
    def due(self) -> bool:
        """Whether it should have been judged by now, but for excuses."""
        return False

    def is_new(self, of: str, now: Scene, within_s: float = inf) -> bool:
        """Whether there was no finding of an agent or sensor within a time, s; now there is."""
        new = of not in self._found_at or now.now - self._found_at[of] > within_s
        if new:
            self._found_at[of] = now.now
        return new

    def on_time(self, now: Scene) -> Iterator[Finding]:  # noqa: ARG002
        """Findings as time passes without a message."""
        yield from ()

    def found(
        self, now: Scene, who: str, what: str, evidence: str = "", answer: Answer = Answer.NO
    ) -> Finding:
        return Finding(self.promise, now.now, who, what, evidence, answer)


def handler_of(rule: Rule, kind: type[Message]) -> Handler | None:
    """Return the method of a rule that receives messages of a kind; None if there is none."""
    found = (getattr(rule, handler_name(each), None) for each in kind.__mro__)
    return next((each for each in found if each is not None), None)
