"""The parts of a robot's page, each with its requests and the data that it shows (sans-IO).

The page has parts of its own (`own.py`). A capability adds others by entry points in the group
`armadico.page`, so the page does not import capabilities.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import ClassVar, Final, Never, Protocol, cast

from armadico.core import guest
from armadico.core.messages import Message
from armadico.core.services import service_of
from armadico.mesh.base import Mesh
from armadico.observe.jsons import Json
from armadico.observe.page_requests import Asked, RequestError, Start
from armadico.observe.view import View

ANSWER_S: Final = 10.0  # default timeout of a query
UNDER_WAY: Final = 8  # pending queries of one browser for one robot


@dataclass(frozen=True)
class Publish:
    """A message to publish on its service's key."""

    message: Message


@dataclass(frozen=True)
class Put:
    """A query; its reply goes to `Desk.on_reply` with its number."""

    number: int
    key: str  # "": that of the message's service
    message: Message
    reply: type[Message]
    timeout: float


@dataclass(frozen=True)
class Answer:
    """The answer to a browser's request."""

    browser: str
    id: int
    ok: bool
    text: str
    over: bool = True  # False: a further answer follows
    more: Json = None  # data for the page


@dataclass(frozen=True)
class Spawn:
    """An agent to start on this machine, beside the page."""

    browser: str
    id: int
    agent: str


class Works(Protocol):
    """What a browser asks for and what takes seconds, on a thread of its own."""

    def __call__(self, mesh: Mesh) -> tuple[str, Json]:
        """Return a sentence and data for the page. Raises ConfigError.

        The robot's mesh is open, and receives for the page meanwhile.
        """


@dataclass(frozen=True)
class Work:
    """Work for a browser; its answer comes when it has ended."""

    browser: str
    id: int
    run: Works


Out = Publish | Put | Answer | Spawn | Work


@dataclass(frozen=True)
class _Waiting:
    browser: str
    id: int
    describe: Callable[[Never], str]


class Desk:
    """The publications, queries and answers of the parts of one robot's page.

    Attributes:
        view: The society.
        bits64: Returns the random number of a stop.
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

    def work(self, browser: str, number: int, run: Works) -> None:
        """Have something done that takes seconds; the session answers the request then."""
        self._out.append(Work(browser, number, run))

    def answer(self, browser: str, number: int, ok: bool, text: str, *, over: bool = True) -> None:
        self._out.append(Answer(browser, number, ok, text, over))

    def query(
        self,
        browser: str,
        number: int,
        message: Message,
        describe: Callable[[Never], str],
        timeout: float = ANSWER_S,
        key: str = "",
    ) -> None:
        """Send a query for a browser; it is answered with `describe(reply)`, or with the refusal.

        Raises RequestError if too many queries of this browser are pending.
        """
        if sum(each.browser == browser for each in self._waiting.values()) >= UNDER_WAY:
            raise RequestError("too many requests at once; wait for the answers")
        service = service_of(type(message))
        assert service.reply is not None, "it is a query"
        self._number += 1
        self._waiting[self._number] = _Waiting(browser, number, describe)
        put = Put(self._number, key, message, service.reply, timeout)
        self._out.append(put)

    def on_reply(self, number: int, reply: Message | None) -> None:
        """Answer the browser of a query; a reply of None is a timeout."""
        waiting = self._waiting.pop(number, None)
        if waiting is None:
            return
        if reply is None:
            self.answer(waiting.browser, waiting.id, False, "no answer: the query timed out")
        elif refusal := getattr(reply, "refusal", ""):
            self.answer(waiting.browser, waiting.id, False, refusal)
        else:
            self.answer(waiting.browser, waiting.id, True, waiting.describe(cast("Never", reply)))

    def drain(self) -> list[Out]:
        """The outputs since the last call, in order."""
        out, self._out = self._out, []
        return out


class Part(guest.Part):
    """One part of a robot's page; subclasses override methods as needed."""

    requests: ClassVar[tuple[type[Asked], ...]] = ()  # the requests that it handles

    def __init__(self, desk: Desk) -> None:
        self.desk = desk

    @property
    def view(self) -> View:
        return self.desk.view

    @property
    def fixed(self) -> Mapping[str, Json]:
        """Data sent to a browser once, when it connects."""
        return {}

    def request(self, browser: str, request: Never, t: float) -> None:
        """Handle a browser's request, of a class in `requests`. Raises RequestError."""

    def receive(self, key: str, message: Message, t: float) -> None:
        """Process a message, published or a reply; the view is already updated."""

    def on_token(self, instance: str, *, there: bool) -> None:
        """Process a liveliness token that appeared or disappeared."""

    def on_leave(self, browser: str) -> None:
        """Process that a browser has disconnected."""

    def wake(self, t: float) -> None:
        """Do what is due at t (s); called in each turn of the session."""

    def startable(self, t: float) -> Collection[str]:  # noqa: ARG002
        """The agents that this part can have started."""
        return ()

    def start(self, browser: str, request: Start, t: float) -> None:
        """Have one of these started."""

    def show(self, parts: dict[str, object], t: float) -> None:
        """Add data to show at t (s), or change them; values are for JSON."""
