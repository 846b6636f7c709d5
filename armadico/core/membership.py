"""Whether a new instance may join: not among agents of another protocol, and some not as a second.

Sans-IO: tokens, cards and the time go in; whose card to ask for, and a verdict, come out. An
instance looks around and joins if nobody is in its way. If its agent must be alone, or owns a
resource, it then shows its token and looks around once more before it does anything.

Who is at work stays and a newcomer goes: a card tells for how many cycles somebody has been. Of two
newcomers that begin in the same instant the one with the smaller id stays. Of two that are both at
work, because a network was cut, the one that has been for longer; about the same, the one with the
smaller id. Who does not give its card keeps a newcomer out, and drives nobody out.

Among agents of two protocols those stay who speak the owner's; without one, the newcomers go. The
owner's token may come last of all, so a newcomer waits for it before it goes.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Final

from armadico.core.messages import PROTOCOL, Card

QUIET_S: Final = 0.1
"""No news of tokens for so long, and everybody who can be seen is taken to be known."""

RESTLESS_S: Final = 0.2
"""So long after the first news it is enough, however many others are coming and going."""

ALONE_S: Final = 0.2
"""Without any news, links may still be coming up for so long."""

TOLD_S: Final = 0.15
"""For so long at least it shows its token before it begins: it is told latched states meanwhile."""

CARD_S: Final = 0.5
"""What somebody may take to give its card; one that hangs keeps nobody waiting for longer."""

AGAIN_S: Final = 5.0
"""Who does not give its card, or is in the way, is asked again after this."""

GRACE_S: Final = 2.0
"""For so long after it has joined it is the newcomer: links that are slow come up meanwhile. Before
it goes for others of another protocol it looks for an owner of its own for as long."""

LEASE_S: Final = 1.0
"""After so long is an instance taken for gone whose machine fell silent."""

GOING_S: Final = 2.0 * LEASE_S
"""What the token of one that is in the way may take to go."""

LITTLE: Final = 10
"""Cycles, and with an eighth of the longer one's: two within this have been at work for as long."""

MUCH: Final = 2
"""By more than so many times that has one been for longer. Both must come to one verdict by cards
that they ask for at different times, and the count goes on meanwhile; in between both ask again.
What is in between stays no longer than until they have been at work for eight times as long, or two
that differ by a second and a half would never part."""


class Stage(Enum):
    """How far it has come."""

    LOOKING = "looks around"
    CLAIMING = "its token can be seen, and it looks around again"
    JOINED = "has joined"
    REFUSED = "may not join, or stay"


class Admission:
    """One instance's way into a namespace."""

    def __init__(
        self,
        name: str,
        instance: str,
        now: float,
        *,
        alone: bool = False,
        owns: Sequence[str] = (),
    ) -> None:
        """Look around.

        Args:
            name: The agent's name.
            instance: The instance's id.
            now: The time, s.
            alone: Whether no second instance of the agent may be alive.
            owns: Resources that nobody else may own.
        """
        self.stage = Stage.LOOKING
        self.refusal = ""
        self.tenure = 0  # cycles for which it has been at work: kept up to date from outside
        self._name, self._instance = name, instance
        self._alone, self._owns = alone, frozenset(owns)
        self._since = now
        self._looked_at = float("-inf")
        self._grace_until: float | None = None
        self._first_at: float | None = None  # when the first news of a token came,
        self._news_at = now  # and the latest
        self._alive: dict[str, tuple[str, float]] = {}  # by instance: its name, and since when
        self._asked: dict[str, float] = {}  # cards that are waited for, since when
        self._ask_at: dict[str, float] = {}
        self._cards: dict[str, Card] = {}

    # What comes in -------------------------------------------------------------------------------

    def appeared(self, name: str, instance: str, now: float) -> None:
        if instance == self._instance or instance in self._alive:
            return
        self._alive[instance] = (name, now)
        self._heard(now)
        self._ask_at[instance] = now

    def disappeared(self, instance: str, now: float) -> None:
        if self._alive.pop(instance, None) is not None:
            self._heard(now)
        for about in (self._asked, self._ask_at, self._cards):
            about.pop(instance, None)

    def answered(self, instance: str, card: Card | None, now: float) -> None:
        """Somebody gave its own card; None: it has not, and is asked again later."""
        self._asked.pop(instance, None)
        if instance not in self._alive:
            return
        if card is not None:
            self._cards[instance] = card
        if card is None or self._is_rival(instance):
            self._ask_at[instance] = now + AGAIN_S

    # What comes out ------------------------------------------------------------------------------

    def questions(self, now: float) -> list[tuple[str, str]]:
        """Whose cards to ask for now, as (name, instance)."""
        due = [instance for instance, at in self._ask_at.items() if at <= now]
        for instance in due:
            del self._ask_at[instance]
            self._asked[instance] = now
        return [(self._alive[instance][0], instance) for instance in due]

    def check(self, now: float) -> Stage:
        """How far it is now; `refusal` says why, if it may not join or stay."""
        self._looked_at = now
        if self.stage is Stage.LOOKING:
            self._check(now)
        elif self.stage is Stage.CLAIMING:
            self._claim(now)
        elif self.stage is Stage.JOINED:
            self._stay()
            if self._grace_until is not None and now >= self._grace_until and not self._waits(now):
                self._grace_until = None  # whoever comes later is the newcomer
                foreign = self._foreign()
                if foreign is not None and not self._owns:  # the others go, where it is the owner
                    self._refuse_among(foreign)
        return self.stage

    @property
    def wakeup(self) -> float | None:
        """When to look again, or to ask, if nothing comes before, s.

        What was over at the last look is not waited for: who waits for more than one thing would be
        woken at once, again and again.
        """
        waits: list[float] = []
        answered = [at + CARD_S for at in self._asked.values()]
        if self._grace_until is not None:
            waits += [max(at, self._grace_until) for at in (*answered, self._grace_until)]
        if self.stage in (Stage.LOOKING, Stage.CLAIMING):
            waits += [self._settled_at, *answered]
            if self._foreign() is not None:
                waits.append(self._since + GRACE_S)
            waits += [self._alive[rival][1] + GOING_S for rival in self._rivals()]
        due = [at for at in waits if at > self._looked_at]
        return min([*due, *self._ask_at.values()], default=None)

    # The rules -----------------------------------------------------------------------------------

    def _check(self, now: float) -> None:
        if self._waits(now) or self._in_place(now):
            return
        foreign = self._foreign()
        if foreign is not None:
            if now >= self._since + GRACE_S:
                self._refuse_among(foreign)
            return
        silent = [rival for rival in self._rivals() if rival not in self._cards]
        if silent or now < self._settled_at:
            return
        self._since = now
        if self._first_at is not None:  # the links are up
            self._first_at = self._news_at = now
        if self._alone or self._owns:
            self.stage = Stage.CLAIMING
        else:
            self._join(now)

    def _claim(self, now: float) -> None:
        if self._waits(now) or self._in_place(now):
            return
        for rival in self._rivals():  # two newcomers
            if rival < self._instance:
                self._refuse_for(rival)
                return
        if now >= self._settled_at and not self._rivals():
            self._join(now)

    def _join(self, now: float) -> None:
        self.stage, self._grace_until = Stage.JOINED, now + GRACE_S

    def _stay(self) -> None:
        """Of two that are both at work one goes; a newcomer goes by itself."""
        for rival in self._rivals():
            card = self._cards.get(rival)
            if card is None or not card.tenure:
                continue
            longer = card.tenure - self.tenure
            little = max(LITTLE, max(card.tenure, self.tenure) // 8)
            alike = abs(longer) <= little and rival < self._instance
            if longer > MUCH * little or alike:
                self._refuse_for(rival)
                return

    def _in_place(self, now: float) -> bool:
        """Refuse, if somebody is at work already, or is in the way and does not go or answer."""
        for rival in self._rivals():
            card = self._cards.get(rival)
            at_work = card is not None and card.tenure > 0
            if at_work or now >= self._alive[rival][1] + GOING_S:
                self._refuse_for(rival)
                return True
        return False

    def _waits(self, now: float) -> bool:
        """Whether a card may still come."""
        return any(now < at + CARD_S for at in self._asked.values())

    @property
    def _settled_at(self) -> float:
        told = self._since + (TOLD_S if self.stage is Stage.CLAIMING else 0.0)
        if self._first_at is None:
            return self._since + ALONE_S
        return max(told, min(self._news_at + QUIET_S, self._first_at + RESTLESS_S))

    def _heard(self, now: float) -> None:
        self._news_at = now
        self._first_at = now if self._first_at is None else self._first_at

    def _is_rival(self, instance: str) -> bool:
        """Whether only one of both may stay."""
        if self._alone and self._alive[instance][0] == self._name:
            return True
        card = self._cards.get(instance)
        return card is not None and not self._owns.isdisjoint(card.owns)

    def _rivals(self) -> list[str]:
        if not (self._alone or self._owns):
            return []
        return [instance for instance in sorted(self._alive) if self._is_rival(instance)]

    def _foreign(self) -> Card | None:
        """Somebody who speaks another protocol, where no owner of a resource speaks this."""
        cards = self._cards.values()
        if any(card.owns and card.protocol == PROTOCOL for card in cards):
            return None
        return next((card for card in cards if card.protocol != PROTOCOL), None)

    def _refuse_among(self, foreign: Card) -> None:
        self._refuse(
            f"{_who(foreign)} speaks protocol {foreign.protocol}, this one {PROTOCOL}; install"
            " the same armadico on every machine, or name another namespace: --namespace"
        )

    def _refuse_for(self, rival: str) -> None:
        card = self._cards.get(rival)
        if card is not None and card.name != self._name:
            both = ", ".join(sorted(self._owns.intersection(card.owns)))
            self._refuse(f"{both} has an owner already: {_who(card)}; end that one first")
            return
        self._refuse(
            f"another {self._name} agent is alive already: {_who(card) if card else rival};"
            " end that one, or name another namespace: --namespace"
        )

    def _refuse(self, why: str) -> None:
        self.stage, self.refusal = Stage.REFUSED, why


def _who(card: Card) -> str:
    return f"{card.instance} (host {card.host}, pid {card.pid}, version {card.version})"
