"""What a robot's page consists of: parts, each with its requests and what it shows (sans-IO).

The page has parts of its own (`own.py`). A capability adds others by an entry point in the group
`armadico.page`, so the page knows no capability.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from armadico.core.messages import Message
from armadico.core.services import service_of
from armadico.gateways.page.requests import Asked, RequestError, Start
from armadico.observe.view import View

ANSWER_S: Final = 10.0
"""Timeout of a query, unless a part names another one."""

UNDER_WAY: Final = 8
"""Queries of one browser that may wait for one robot's answers."""


@dataclass(frozen=True)
class Publish:
    """A message to be published on its service's key."""

    message: Message


@dataclass(frozen=True)
class Put:
    """A query; its answer goes to `Desk.answered` by its number."""

    number: int
    key: str
    message: Message
    reply: type[Message]
    timeout: float


@dataclass(frozen=True)
class Tell:
    """The answer to a browser's request."""

    browser: str
    id: int
    ok: bool
    text: str
    over: bool = True
    """False: a further answer follows."""


@dataclass(frozen=True)
class Spawn:
    """An agent to be started here, beside the page."""

    browser: str
    id: int
    agent: str


Out = Publish | Put | Tell | Spawn


@dataclass(frozen=True)
class _Waiting:
    browser: str
    id: int
    describe: Callable[[Any], str]


class Desk:
    """What the parts of one robot's page publish, query and answer.

    Attributes:
        view: The society.
        bits64: Draws the number that distinguishes one stop from another.
    """

    def __init__(self, view: View, bits64: Callable[[], int]) -> None:
        self.view, self.bits64 = view, bits64
        self._out: list[Out] = []
        self._number = 0
        self._waiting: dict[int, _Waiting] = {}

    def publish(self, message: Message) -> None:
        self._out.append(Publish(message))

    def spawn(self, browser: str, number: int, agent: str) -> None:
        """Start an agent beside the page; the session answers the request."""
        self._out.append(Spawn(browser, number, agent))

    def tell(self, browser: str, number: int, ok: bool, text: str, *, over: bool = True) -> None:
        """Answer a browser's request."""
        self._out.append(Tell(browser, number, ok, text, over))

    def query(
        self,
        browser: str,
        number: int,
        message: Message,
        describe: Callable[[Any], str],
        timeout: float = ANSWER_S,
        key: str = "",
    ) -> None:
        """Put a query for a browser; its answer is told as `describe` says, or as its refusal.

        Raises RequestError if too many queries of this browser wait already.
        """
        if sum(each.browser == browser for each in self._waiting.values()) >= UNDER_WAY:
            raise RequestError("too much is asked for at once")
        service = service_of(type(message))
        assert service.reply is not None, "it is a query"
        self._number += 1
        self._waiting[self._number] = _Waiting(browser, number, describe)
        put = Put(self._number, key or service.key, message, service.reply, timeout)
        self._out.append(put)

    def answered(self, number: int, reply: Message | None) -> None:
        """A query's reply; None: it was not answered in time."""
        waiting = self._waiting.pop(number, None)
        if waiting is None:
            return
        if reply is None:
            self.tell(waiting.browser, waiting.id, False, "nobody answered")
        elif refusal := getattr(reply, "refusal", ""):
            self.tell(waiting.browser, waiting.id, False, refusal)
        else:
            self.tell(waiting.browser, waiting.id, True, waiting.describe(reply))

    def drain(self) -> list[Out]:
        """What is to be published, queried and told, in this order; each once."""
        out, self._out = self._out, []
        return out


class Part:
    """One part of a robot's page; each method may be left as it is here."""

    requests: ClassVar[tuple[type[Asked], ...]] = ()
    """The requests that it takes."""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk

    @property
    def view(self) -> View:
        return self.desk.view

    @property
    def fixed(self) -> Mapping[str, Any]:
        """What a browser is shown once, when it connects."""
        return {}

    def request(self, browser: str, request: Any, t: float) -> None:
        """A browser's request. Raises RequestError if it cannot be met."""

    def receive(self, key: str, message: Message, t: float) -> None:
        """A message, published or answered; the view has it already."""

    def on_token(self, instance: str, *, there: bool) -> None:
        """A liveliness token appeared or disappeared."""

    def on_leave(self, browser: str) -> None:
        """A browser has disconnected."""

    def wake(self, t: float) -> None:
        """Do what is due at t (s); called in each turn of the session."""

    def startable(self, t: float) -> Collection[str]:  # noqa: ARG002
        """The agents that it could have started."""
        return ()

    def start(self, browser: str, request: Start, t: float) -> None:
        """Have one of these started."""

    def show(self, parts: dict[str, Any], t: float) -> None:
        """Add to what is shown at t (s), or amend it; values are for JSON."""
