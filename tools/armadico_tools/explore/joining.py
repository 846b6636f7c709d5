"""Every run of the real `Admission`: instances of one name that must be alone, and a slow network.

Each instance shows its token, asks for cards and gives its own, as the driver of an agent does. How
long each token and each card takes is picked, and who begins when, and which link is cut and when
it heals. Promised: never two at work for good, and never none where one
was.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from armadico.core.membership import AGAIN_S, CARD_S, GOING_S, LEASE_S, Admission, Stage
from armadico.core.messages import PROTOCOL, Card
from armadico_tools.explore.picks import Picker

CYCLE_S: Final = 0.1
LATENCY_S: Final = 0.002

TOKENS: Final = ("at once", "0.12 s", "0.3 s")
"""Delays of a token's news. A link that is up brings it within these, or is no link yet."""

CARDS: Final = ("at once", "0.12 s", "0.4 s", "never")

BEGINS: Final = ("with it", "0.01 s", "0.15 s", "0.25 s", "2.5 s", "4 s")
"""How long after the one before an instance begins."""

CUTS: Final = ("nothing", "0.1 s for 0.6 s", "0.3 s for 1.5 s", "3 s for 3 s", "3 s for 8 s")
"""When a link is cut after the later one began, and for how long."""

AFTER_S: Final = GOING_S + 6 * AGAIN_S + 2 * CARD_S
"""All has come right so long after the last begun or healed."""

NAME: Final = "robot"


@dataclass(frozen=True)
class Joining:
    """Where a run begins: the order of the ids is that in which they begin, or the other."""

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
        self._those: dict[str, Admission] = {}
        self._began: dict[str, float] = {}
        self._joined: dict[str, float] = {}
        self._shown: set[str] = set()
        self._seen: set[tuple[str, str]] = set()  # (who, whose token)
        self._down: set[frozenset[str]] = set()
        self._wakes: dict[str, float] = {}
        self._changed_at = 0.0
        self._spins = ""
        self._plan()

    @property
    def at_work(self) -> list[str]:
        return [who for who, each in self._those.items() if each.stage is Stage.JOINED]

    @property
    def stages(self) -> dict[str, str]:
        """How far each has come."""
        return {who: each.stage.name for who, each in self._those.items()}

    def run(self) -> str:
        """Let it all happen; which promise is broken, or nothing."""
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

    # What happens --------------------------------------------------------------------------------

    def _plan(self) -> None:
        names = [f"{NAME}-{n}" for n in range(1, self.setup.instances + 1)]
        if self.setup.reversed:
            names.reverse()
        at = 1.0
        for number, who in enumerate(names):
            if number:
                how = self._picker.pick(f"{who} begins", BEGINS, 0)
                at += 0.0 if how == "with it" else _seconds(how)
            self._at(at, self._begin, who)
        for number, who in enumerate(names):
            for other in names[number + 1 :]:
                how = self._picker.pick(f"cut {who}-{other}", CUTS, 1)
                if how != "nothing":
                    after, _, lasts = how.partition(" s for ")
                    link = frozenset((who, other))
                    self._at(at + float(after), self._cut, link)
                    self._at(at + float(after) + _seconds(lasts), self._heal, link)

    def _at(self, when: float, call: Any, *about: Any) -> None:
        self._count += 1
        heapq.heappush(self._heap, (when, self._count, call, about))

    def _begin(self, who: str) -> None:
        self._changed_at = self.now
        self._those[who] = self._kind(NAME, who, self.now, alone=True)
        self._began[who] = self.now
        for other in sorted(self._shown):
            self._tell(who, other)
        self._progress(who)

    def _progress(self, who: str) -> None:
        admission = self._those[who]
        if admission.stage is Stage.REFUSED:
            return
        admission.tenure = self._tenure(who)
        for _, other in admission.queries(self.now):
            self._ask(who, other)
        stage = admission.check(self.now)
        if stage in (Stage.CLAIMING, Stage.JOINED) and who not in self._shown:
            self._shown.add(who)
            for other in self._those:
                if other != who:
                    self._tell(other, who)
        if stage is Stage.JOINED and who not in self._joined:
            self._joined[who] = self.now
            self.worked.add(who)
        if stage is Stage.REFUSED:
            self._joined.pop(who, None)
            self._shown.discard(who)
            for other in self._those:
                if (other, who) in self._seen:
                    self._at(self.now + LATENCY_S, self._disappear, other, who)
            return
        due = admission.wakeup
        if due is not None and due <= self.now:
            self._spins = self._spins or f"{who}, {admission.stage.value}, at {self.now:.3f} s"
            due = self.now + 0.01
        if due is not None and self._wakes.get(who) != due:
            self._wakes[who] = due
            self._at(max(due, self.now), self._wake, who, due)

    def _wake(self, who: str, due: float) -> None:
        if self._wakes.get(who) == due:
            del self._wakes[who]
            self._progress(who)

    def _tenure(self, who: str) -> int:
        """Cycles for which it has been at work; the first is the one in which it joined."""
        at = self._joined.get(who)
        return 0 if at is None else 1 + int((self.now - at) / CYCLE_S)

    def _up(self, one: str, other: str) -> bool:
        return frozenset((one, other)) not in self._down

    def _tell(self, who: str, of: str) -> None:
        """News of a token that is shown comes some time, if the link is up."""
        if not self._up(who, of):
            return
        how = self._picker.pick(f"token of {of} to {who}", TOKENS, 1)
        self._at(self.now + _seconds(how), self._appear, who, of)

    def _appear(self, who: str, of: str) -> None:
        if not self._up(who, of) or of not in self._shown or (who, of) in self._seen:
            return
        self._seen.add((who, of))
        self._those[who].appeared(NAME, of, self.now)
        self._progress(who)

    def _disappear(self, who: str, of: str) -> None:
        if (who, of) in self._seen:
            self._seen.discard((who, of))
            self._those[who].disappeared(of, self.now)
            self._progress(who)

    def _ask(self, who: str, other: str) -> None:
        how = self._picker.pick(f"card of {other} to {who}", CARDS, 1)
        if how == "never" or not self._up(who, other):
            self._at(self.now + CARD_S, self._answer, who, other, None)
        else:
            self._at(self.now + LATENCY_S, self._give, who, other, _seconds(how))

    def _give(self, who: str, other: str, takes: float) -> None:
        """Its card has what is so when it is queried, and is some time under way."""
        shown = other in self._shown and self._up(who, other)
        card = None
        if shown:
            tenure = self._tenure(other)
            card = Card(NAME, other, "host", 1, "1", PROTOCOL, (), (), (), tenure=tenure)
        self._at(self.now + takes, self._answer, who, other, card)

    def _answer(self, who: str, other: str, card: Card | None) -> None:
        if self._those[who].stage is Stage.REFUSED:
            return
        if card is not None and not self._up(who, other):
            card = None
        self._those[who].on_card(other, card, self.now)
        self._progress(who)

    def _cut(self, link: frozenset[str]) -> None:
        self._changed_at = self.now
        self._down.add(link)
        self._at(self.now + LEASE_S, self._expire, link)

    def _expire(self, link: frozenset[str]) -> None:
        """The lease has run out: each sees the other's token go."""
        if link not in self._down:
            return
        one, other = sorted(link)
        for who, of in ((one, other), (other, one)):
            self._disappear(who, of)

    def _heal(self, link: frozenset[str]) -> None:
        self._changed_at = self.now
        self._down.discard(link)
        one, other = sorted(link)
        for who, of in ((one, other), (other, one)):
            if of in self._shown and who in self._those and (who, of) not in self._seen:
                self._tell(who, of)
            if of not in self._shown and (who, of) in self._seen:
                self._at(self.now + LATENCY_S, self._disappear, who, of)


def _seconds(how: str) -> float:
    return LATENCY_S if how == "at once" else float(how.removesuffix(" s"))


def setups(instances: int) -> Sequence[Joining]:
    """Where runs begin, for so many instances."""
    return [Joining(instances, backwards) for backwards in (False, True)]
