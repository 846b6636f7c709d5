"""Whether a new instance may join: not among agents of another protocol, and some not as a second.

Sans-IO: tokens, cards and the time go in; whose card to ask for, and a verdict, come out. An
instance looks around, joins if nobody is in its way, and, if its agent must be alone, looks around
once more with its token shown before it does anything: of two that begin in the same instant the
one with the smaller id stays. That rule holds for ever after, so that two sides of a network that
was cut do not stay two.

Among agents of two protocols those stay who speak the robot agent's; without one, the newcomers go.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

from armadico.messages import PROTOCOL, Card

QUIET_S: Final = 0.1
"""No news of tokens for so long, and everybody who can be seen is taken to be known."""

RESTLESS_S: Final = 0.2
"""So long after the first news it is enough, however many others are coming and going."""

ALONE_S: Final = 0.2
"""Without any news, links may still be coming up for so long."""

CARD_S: Final = 0.5
"""What somebody may take to give its card; one that hangs keeps nobody waiting for longer."""

AGAIN_S: Final = 5.0
"""Who does not give its card is asked again after this."""

GRACE_S: Final = 2.0
"""For so long after it has joined it is the newcomer: links that are slow come up meanwhile."""

OWNER: Final = "robot"
"""The agent whose protocol is the namespace's, if it is there."""

LEASE_S: Final = 1.0
"""After so long is an instance taken for gone whose machine fell silent."""

GOING_S: Final = 2.0 * LEASE_S
"""What the token of one that is in the way may take to go."""


class Stage(Enum):
    """How far it has come."""

    LOOKING = "looks around"
    CLAIMING = "its token can be seen, and it looks around again"
    JOINED = "has joined"
    REFUSED = "may not join, or stay"


class Admission:
    """One instance's way into a namespace."""

    def __init__(self, name: str, instance: str, now: float, *, alone: bool = False) -> None:
        """Look around; `alone`: no second instance of the agent may be there."""
        self.stage = Stage.LOOKING
        self.refusal = ""
        self._name, self._instance, self._alone = name, instance, alone
        self._since = now
        self._grace_until: float | None = None
        self._first_at: float | None = None  # when the first news of a token came,
        self._news_at = now  # and the latest
        self._there: dict[str, tuple[str, float]] = {}  # by instance: its name, and since when
        self._asked: dict[str, float] = {}  # cards that are waited for, since when
        self._ask_at: dict[str, float] = {}
        self._cards: dict[str, Card] = {}

    # What comes in -------------------------------------------------------------------------------

    def appeared(self, name: str, instance: str, now: float) -> None:
        """A token is there."""
        if instance == self._instance or instance in self._there:
            return
        self._there[instance] = (name, now)
        self._heard(now)
        self._ask_at[instance] = now

    def disappeared(self, instance: str, now: float) -> None:
        """A token has gone."""
        if self._there.pop(instance, None) is not None:
            self._heard(now)
        for about in (self._asked, self._ask_at, self._cards):
            about.pop(instance, None)

    def answered(self, instance: str, card: Card | None, now: float) -> None:
        """Somebody gave its card; None: it has not, and is asked again later."""
        self._asked.pop(instance, None)
        if instance not in self._there or instance in self._cards:
            return
        if card is None:
            self._ask_at[instance] = now + AGAIN_S
        else:
            self._cards[instance] = card

    # What comes out ------------------------------------------------------------------------------

    def questions(self, now: float) -> list[tuple[str, str]]:
        """Whose cards to ask for now, as (name, instance)."""
        due = [instance for instance, at in self._ask_at.items() if at <= now]
        for instance in due:
            del self._ask_at[instance]
            self._asked[instance] = now
        return [(self._there[instance][0], instance) for instance in due]

    def look(self, now: float) -> Stage:
        """How far it is now; `refusal` says why, if it may not join or stay."""
        if self.stage is Stage.LOOKING:
            self._look(now)
        elif self.stage is Stage.CLAIMING:
            self._claim(now)
        elif self.stage is Stage.JOINED and self._alone:
            self._hold(now)
        elif self._grace_until is not None and now >= self._grace_until:
            self._grace_until = None  # whoever comes later is the newcomer
            self._misplaced()
        return self.stage

    @property
    def wakeup(self) -> float | None:
        """When to look again, or to ask, if nothing comes before, s."""
        due = list(self._ask_at.values())
        if self._grace_until is not None:
            due.append(self._grace_until)
        if self.stage is not Stage.LOOKING:
            smaller = (rival for rival in self._rivals if rival < self._instance)
            due += [self._asked[rival] + CARD_S for rival in smaller if rival in self._asked]
        if self.stage in (Stage.LOOKING, Stage.CLAIMING):
            if self._rivals:
                due += [since + GOING_S for _, since in self._rivals.values()]
            else:
                due.append(max([self._settled_at, *(at + CARD_S for at in self._asked.values())]))
        return min(due, default=None)

    # The rules -----------------------------------------------------------------------------------

    def _look(self, now: float) -> None:
        for instance, (_, since) in self._rivals.items():
            if now >= since + GOING_S:
                self._refuse_for(instance)
                return
        if not self._settled(now) or self._misplaced():
            return
        if self._alone:
            self.stage = Stage.CLAIMING
        else:
            self.stage, self._grace_until = Stage.JOINED, now + GRACE_S
        if self._first_at is None:
            self._since = now
        else:  # the links are up
            self._first_at = self._news_at = now

    def _claim(self, now: float) -> None:
        self._hold(now)
        if self.stage is Stage.REFUSED:
            return
        for instance, (_, since) in self._rivals.items():
            if now >= since + GOING_S:  # it has the larger id, and does not leave
                self._refuse_for(instance)
                return
        if self._settled(now):
            self.stage = Stage.JOINED

    def _hold(self, now: float) -> None:
        """The smaller id stays; the other waits for its card before it says who that is."""
        for instance in sorted(self._rivals):
            waits = now < self._asked.get(instance, float("-inf")) + CARD_S
            if instance < self._instance and not waits:
                self._refuse_for(instance)
                return

    def _settled(self, now: float) -> bool:
        waits = any(now < at + CARD_S for at in self._asked.values())
        return now >= self._settled_at and not waits and not self._rivals

    @property
    def _settled_at(self) -> float:
        if self._first_at is None:
            return self._since + ALONE_S
        return min(self._news_at + QUIET_S, self._first_at + RESTLESS_S)

    def _heard(self, now: float) -> None:
        self._news_at = now
        self._first_at = now if self._first_at is None else self._first_at

    @property
    def _rivals(self) -> dict[str, tuple[str, float]]:
        if not self._alone:
            return {}
        return {who: about for who, about in self._there.items() if about[0] == self._name}

    def _misplaced(self) -> bool:
        """Refuse, if the others speak another protocol and no robot agent speaks this one."""
        cards = self._cards.values()
        if any(card.name == OWNER and card.protocol == PROTOCOL for card in cards):
            return False
        foreign = next((card for card in cards if card.protocol != PROTOCOL), None)
        if foreign is None:
            return False
        self._refuse(
            f"{_who(foreign)} speaks protocol {foreign.protocol}, this one {PROTOCOL}; install"
            " the same armadico on every machine, or name another namespace: --namespace"
        )
        return True

    def _refuse_for(self, rival: str) -> None:
        card = self._cards.get(rival)
        self._refuse(
            f"another {self._name} agent is there already: {_who(card) if card else rival};"
            " end that one, or name another namespace: --namespace"
        )

    def _refuse(self, why: str) -> None:
        self.stage, self.refusal = Stage.REFUSED, why


def _who(card: Card) -> str:
    return f"{card.instance} (host {card.host}, pid {card.pid}, version {card.version})"
