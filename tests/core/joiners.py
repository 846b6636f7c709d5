"""A run of the real `Admission`: instances of one name that must be alone, and a slow network.

Each instance shows its token, queries cards and answers queries, as the driver of an agent does.
Picked are the delay of each token and card, when each instance starts, and which link is cut, and
for how long. Promises: two instances never work permanently, and an instance never disappears
without a successor.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

from armadico.core.membership import AGAIN_S, CARD_S, GOING_S, LEASE_S, Admission, Stage
from armadico.core.messages import PROTOCOL, Card

CYCLE_S: Final = 0.1
LATENCY_S: Final = 0.002

TOKENS: Final = ("at once", "0.12 s", "0.3 s")
"""Delays of a token. A link delivers it within these, or does not count as up."""

CARDS: Final = ("at once", "0.12 s", "0.4 s", "never")

BEGINS: Final = ("with it", "0.01 s", "0.15 s", "0.25 s", "2.5 s", "4 s")
"""Delay from the start of one instance to the next."""

CUTS: Final = ("nothing", "0.1 s for 0.6 s", "0.3 s for 1.5 s", "3 s for 3 s", "3 s for 8 s")
"""When a link is cut after the last start, and for how long."""

AFTER_S: Final = GOING_S + 6 * AGAIN_S + 2 * CARD_S
"""Time to settle after the last start or repair."""

NAME: Final = "robot"


class Picker(Protocol):
    """Picks one of the alternatives of a decision; all but the first may have a cost."""

    def pick(self, what: str, ways: Sequence[str], cost: int) -> str: ...


@dataclass(frozen=True)
class Joining:
    """The start of a run; the ids are in order of starting, or `reversed`."""

    instances: int = 2
    reversed: bool = False


class Joiners:
    """The instances, and the network between them."""

    def __init__(
        self, setup: Joining, picker: Picker, admission: type[Admission] = Admission
    ) -> None:
        self.now = 0.0
        self.setup = setup
        self.worked: set[str] = set()
        self._kind = admission
        self._picker = picker
        self._heap: list[tuple[float, int, Any, tuple[Any, ...]]] = []
        self._count = 0
        self._admissions: dict[str, Admission] = {}
        self._joined: dict[str, float] = {}
        self._shown: set[str] = set()
        self._seen: set[tuple[str, str]] = set()  # (instance, the instance whose token it sees)
        self._down: set[frozenset[str]] = set()
        self._wakes: dict[str, float] = {}
        self._changed_at = 0.0
        self._spins = ""
        self._plan()

    @property
    def at_work(self) -> list[str]:
        return [name for name, each in self._admissions.items() if each.stage is Stage.JOINED]

    @property
    def stages(self) -> dict[str, str]:
        """The stage of each instance."""
        return {name: each.stage.name for name, each in self._admissions.items()}

    def run(self) -> str:
        """Run to the end. Returns the broken promise, or ""."""
        while self._heap and self._heap[0][0] <= self._changed_at + AFTER_S:
            self.now, _, call, about = heapq.heappop(self._heap)
            call(*about)
        if self._spins:
            return f"no busy loop: woken again at once, {self._spins}"
        if len(self.at_work) > 1:
            return f"one stays: {' and '.join(self.at_work)} are both at work for good"
        if self.worked and not self.at_work:
            return f"one stays: none is left, and {', '.join(sorted(self.worked))} was at work"
        if not self.at_work:
            return f"one joins: {self.stages}"
        return ""

    # Events --------------------------------------------------------------------------------------

    def _plan(self) -> None:
        names = [f"{NAME}-{n}" for n in range(1, self.setup.instances + 1)]
        if self.setup.reversed:
            names.reverse()
        at = 1.0
        for number, name in enumerate(names):
            if number:
                how = self._picker.pick(f"{name} begins", BEGINS, 0)
                at += 0.0 if how == "with it" else _seconds(how)
            self._at(at, self._begin, name)
        for number, name in enumerate(names):
            for other in names[number + 1 :]:
                how = self._picker.pick(f"cut {name}-{other}", CUTS, 1)
                if how != "nothing":
                    after, _, lasts = how.partition(" s for ")
                    link = frozenset((name, other))
                    self._at(at + float(after), self._cut, link)
                    self._at(at + float(after) + _seconds(lasts), self._heal, link)

    def _at(self, when: float, call: Any, *about: Any) -> None:
        self._count += 1
        heapq.heappush(self._heap, (when, self._count, call, about))

    def _begin(self, name: str) -> None:
        self._changed_at = self.now
        self._admissions[name] = self._kind(NAME, name, self.now, alone=True)
        for other in sorted(self._shown):
            self._send_token(name, other)
        self._progress(name)

    def _progress(self, name: str) -> None:
        admission = self._admissions[name]
        if admission.stage is Stage.REFUSED:
            return
        admission.tenure = self._tenure(name)
        for _, other in admission.queries(self.now):
            self._query(name, other)
        stage = admission.check(self.now)
        if stage in (Stage.CLAIMING, Stage.JOINED) and name not in self._shown:
            self._shown.add(name)
            for other in self._admissions:
                if other != name:
                    self._send_token(other, name)
        if stage is Stage.JOINED and name not in self._joined:
            self._joined[name] = self.now
            self.worked.add(name)
        if stage is Stage.REFUSED:
            self._joined.pop(name, None)
            self._shown.discard(name)
            for other in self._admissions:
                if (other, name) in self._seen:
                    self._at(self.now + LATENCY_S, self._disappear, other, name)
            return
        due = admission.wakeup
        if due is not None and due <= self.now:
            self._spins = self._spins or f"{name}, {admission.stage.value}, at {self.now:.3f} s"
            due = self.now + 0.01
        if due is not None and self._wakes.get(name) != due:
            self._wakes[name] = due
            self._at(max(due, self.now), self._wake, name, due)

    def _wake(self, name: str, due: float) -> None:
        if self._wakes.get(name) == due:
            del self._wakes[name]
            self._progress(name)

    def _tenure(self, name: str) -> int:
        """Cycles for which an instance has worked, including that of joining."""
        at = self._joined.get(name)
        return 0 if at is None else 1 + int((self.now - at) / CYCLE_S)

    def _up(self, one: str, other: str) -> bool:
        return frozenset((one, other)) not in self._down

    def _send_token(self, name: str, of: str) -> None:
        """Deliver a shown token after a delay, if the link is up."""
        if not self._up(name, of):
            return
        how = self._picker.pick(f"token of {of} to {name}", TOKENS, 1)
        self._at(self.now + _seconds(how), self._appear, name, of)

    def _appear(self, name: str, of: str) -> None:
        if not self._up(name, of) or of not in self._shown or (name, of) in self._seen:
            return
        self._seen.add((name, of))
        self._admissions[name].appeared(NAME, of, self.now)
        self._progress(name)

    def _disappear(self, name: str, of: str) -> None:
        if (name, of) in self._seen:
            self._seen.discard((name, of))
            self._admissions[name].disappeared(of, self.now)
            self._progress(name)

    def _query(self, name: str, other: str) -> None:
        how = self._picker.pick(f"card of {other} to {name}", CARDS, 1)
        if how == "never" or not self._up(name, other):
            self._at(self.now + CARD_S, self._answer, name, other, None)
        else:
            self._at(self.now + LATENCY_S, self._reply, name, other, _seconds(how))

    def _reply(self, name: str, other: str, takes: float) -> None:
        """Send a card with the tenure at the time of the query; it arrives later."""
        shown = other in self._shown and self._up(name, other)
        card = None
        if shown:
            tenure = self._tenure(other)
            card = Card(NAME, other, "host", 1, "1", PROTOCOL, (), (), (), tenure=tenure)
        self._at(self.now + takes, self._answer, name, other, card)

    def _answer(self, name: str, other: str, card: Card | None) -> None:
        if self._admissions[name].stage is Stage.REFUSED:
            return
        if card is not None and not self._up(name, other):
            card = None
        self._admissions[name].on_card(other, card, self.now)
        self._progress(name)

    def _cut(self, link: frozenset[str]) -> None:
        self._changed_at = self.now
        self._down.add(link)
        self._at(self.now + LEASE_S, self._expire, link)

    def _expire(self, link: frozenset[str]) -> None:
        """Remove each other's token when the lease has expired."""
        if link not in self._down:
            return
        one, other = sorted(link)
        for name, of in ((one, other), (other, one)):
            self._disappear(name, of)

    def _heal(self, link: frozenset[str]) -> None:
        self._changed_at = self.now
        self._down.discard(link)
        one, other = sorted(link)
        for name, of in ((one, other), (other, one)):
            if of in self._shown and name in self._admissions and (name, of) not in self._seen:
                self._send_token(name, of)
            if of not in self._shown and (name, of) in self._seen:
                self._at(self.now + LATENCY_S, self._disappear, name, of)


def _seconds(how: str) -> float:
    return LATENCY_S if how == "at once" else float(how.removesuffix(" s"))
