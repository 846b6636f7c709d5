"""Admission: whether a new instance may join, and stay.

Sans-IO: tokens, cards and the time go in; cards to query and a verdict come out. An instance
observes the tokens of others and joins if none conflicts with it. If its agent must be alone, or
owns a resource, it then announces its own token and observes once more before it works.

The instance that works stays and a newcomer leaves; a card has the number of cycles worked. Of two
newcomers at the same time the one with the smaller id stays. Two instances that both work, after
a partitioned network, compare their cycles: the longer one stays, or of about equal ones the
smaller id. An instance that does not reply with its card keeps a newcomer out and displaces none.

An agent understands its own protocol and the one before (`Card.understood`). Of agents that do not
understand each other those stay that the owner understands; without an owner, the newcomers leave.
The owner's token may come last, so a newcomer waits for it before it leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Final

from msgspec.structs import replace

from armadico.core.individual import Rights
from armadico.core.messages import PROTOCOL, Card, protocols

QUIET_S: Final = 0.1  # all tokens count as known after no change of a token for this time
RESTLESS_S: Final = 0.2  # or after this time since the first change, however many follow
ALONE_S: Final = 0.2  # without any token, links may still be coming up for this time
# How long at least an instance announces its token before it starts. It receives the latched states
# meanwhile.
ANNOUNCED_S: Final = 0.15
CARD_S: Final = 0.5  # timeout of a query for a card
AGAIN_S: Final = 5.0  # when a card is queried again after a timeout, or if it conflicts
# Each further timeout of an instance that does not conflict doubles that, up to this multiple: a
# token without an agent costs each process a query each time.
PATIENCE: Final = 16
# For so long after it has joined, an instance counts as the newcomer, as slow links come up. For as
# long it waits for an owner of its own protocol before it leaves.
GRACE_S: Final = 2.0
LEASE_S: Final = 1.0  # when the token of a disconnected instance disappears
GOING_S: Final = 2.0 * LEASE_S  # timeout for the token of a conflicting instance to disappear

# Two instances have worked for about as long if they differ by at most this many cycles, or by an
# eighth of the longer one's.
LITTLE: Final = 10

# Beyond this multiple of that difference one has worked for longer. In between both query the cards
# again: they must reach the same verdict, although they query at different times and the counts
# grow. They reach it at the latest at eight times the age; otherwise two instances that differ by
# 1.5 s would never separate.
MUCH: Final = 2


def agent_of(instance: str) -> str:
    """Return the name of the agent in an instance's identifier."""
    return instance.rpartition("-")[0] or instance


class Stage(Enum):
    """The progress of an admission."""

    LOOKING = "observes the tokens of others"
    CLAIMING = "announces its token and observes again"
    JOINED = "has joined"
    REFUSED = "may not join, or stay"


class Admission:
    """One instance's admission to a namespace."""

    def __init__(
        self,
        name: str,
        instance: str,
        now: float,
        *,
        alone: bool = False,
        owns: Sequence[str] = (),
        protocol: int = PROTOCOL,
        rights: Rights | None = None,
    ) -> None:
        """Begin to observe.

        `alone`: no second instance of the agent may be alive. `owns` are resources that no other
        instance may own. `rights` are as in `Identity`: with keys, a card that claims a resource
        which its instance may not own keeps the owner out no more.
        """
        self.stage = Stage.LOOKING
        self.refusal = ""
        self.tenure = 0  # cycles for which it has worked: updated by the driver
        self._name, self._instance = name, instance
        self._alone, self._owns, self._protocol = alone, frozenset(owns), protocol
        self._rights = rights
        self._since = now
        self._checked_at = float("-inf")
        self._grace_until: float | None = None
        self._first_at: float | None = None  # time of the first change of a token,
        self._changed_at = now  # and of the latest
        self._alive: dict[str, tuple[str, float]] = {}  # by instance: name, time of appearance
        self._queried: dict[str, float] = {}  # by instance: when its card was queried
        self._query_at: dict[str, float] = {}  # by instance: when its card is to be queried
        self._cards: dict[str, Card] = {}
        self._patience: dict[str, int] = {}  # by instance that did not reply: of `AGAIN_S`

    # Inputs --------------------------------------------------------------------------------------

    def appeared(self, name: str, instance: str, now: float) -> None:
        if instance == self._instance or instance in self._alive:
            return
        self._alive[instance] = (name, now)
        self._note_change(now)
        self._query_at[instance] = now

    def disappeared(self, instance: str, now: float) -> None:
        if self._alive.pop(instance, None) is not None:
            self._note_change(now)
        for by_instance in (self._queried, self._query_at, self._cards, self._patience):
            by_instance.pop(instance, None)

    def on_card(self, instance: str, card: Card | None, now: float) -> None:
        """Process an instance's own card; None: timed out, and queried again later."""
        self._queried.pop(instance, None)
        if instance not in self._alive:
            return
        if card is not None:
            self._cards[instance] = self._rightful(instance, card)
        if self._is_rival(instance):
            self._query_at[instance] = now + AGAIN_S
        elif card is None:
            times = self._patience.get(instance, 1)
            self._patience[instance] = min(2 * times, PATIENCE)
            self._query_at[instance] = now + times * AGAIN_S

    # Outputs -------------------------------------------------------------------------------------

    def queries(self, now: float) -> list[tuple[str, str]]:
        """Return the (name, instance) whose cards are to be queried now."""
        due = [instance for instance, at in self._query_at.items() if at <= now]
        for instance in due:
            del self._query_at[instance]
            self._queried[instance] = now
        return [(self._alive[instance][0], instance) for instance in due]

    def check(self, now: float) -> Stage:
        """Return the stage now; `refusal` has the reason if it may not join or stay."""
        self._checked_at = now
        if self.stage is Stage.LOOKING:
            self._check(now)
        elif self.stage is Stage.CLAIMING:
            self._claim(now)
        elif self.stage is Stage.JOINED:
            self._stay()
            if self._grace_until is not None and now >= self._grace_until and not self._waits(now):
                self._grace_until = None  # later instances are the newcomers
                foreign = self._foreign()
                if foreign is not None and not self._owns:  # agents of the owner's protocol stay
                    self._refuse_among(foreign)
        return self.stage

    @property
    def wakeup(self) -> float | None:
        """When `check` or `queries` is due next, s; None: not at all."""
        waits: list[float] = []
        timeouts = [at + CARD_S for at in self._queried.values()]
        if self._grace_until is not None:
            waits += [max(at, self._grace_until) for at in (*timeouts, self._grace_until)]
        if self.stage in (Stage.LOOKING, Stage.CLAIMING):
            waits += [self._settled_at, *timeouts]
            if self._foreign() is not None:
                waits.append(self._since + GRACE_S)
            waits += [self._alive[rival][1] + GOING_S for rival in self._rivals()]
        # A time before the last check is over. Otherwise an instance that waits for several
        # conditions would be woken at once, again and again.
        due = [at for at in waits if at > self._checked_at]
        return min([*due, *self._query_at.values()], default=None)

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
            self._first_at = self._changed_at = now
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
        """Refuse to stay beside a rival that has worked for longer; a newcomer leaves by itself."""
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
        """Refuse if a rival works already, or neither replies nor disappears; return whether."""
        for rival in self._rivals():
            card = self._cards.get(rival)
            at_work = card is not None and card.tenure > 0
            if at_work or now >= self._alive[rival][1] + GOING_S:
                self._refuse_for(rival)
                return True
        return False

    def _waits(self, now: float) -> bool:
        """Return whether a card may still arrive."""
        return any(now < at + CARD_S for at in self._queried.values())

    @property
    def _settled_at(self) -> float:
        announced = self._since + (ANNOUNCED_S if self.stage is Stage.CLAIMING else 0.0)
        if self._first_at is None:
            return self._since + ALONE_S
        return max(announced, min(self._changed_at + QUIET_S, self._first_at + RESTLESS_S))

    def _note_change(self, now: float) -> None:
        self._changed_at = now
        self._first_at = now if self._first_at is None else self._first_at

    def _is_rival(self, instance: str) -> bool:
        """Return whether only one of both may stay."""
        if self._alone and self._alive[instance][0] == self._name:
            return True
        card = self._cards.get(instance)
        return card is not None and not self._owns.isdisjoint(card.owns)

    def _rightful(self, instance: str, card: Card) -> Card:
        """Return a card without the resources that its instance may not own."""
        rights = self._rights
        if rights is None:
            return card
        owns = tuple(name for name in card.owns if rights.may_own(instance, name))
        return replace(card, owns=owns)

    def _rivals(self) -> list[str]:
        if not (self._alone or self._owns):
            return []
        return [instance for instance in sorted(self._alive) if self._is_rival(instance)]

    def _foreign(self) -> Card | None:
        """Return a card that is not understood, if no owner's card of a resource is.

        With keys only an owner keeps an owner out: the card of any member may lie.
        """
        cards, own = list(self._cards.values()), self._protocol
        if self._rights is not None and self._owns:
            cards = [card for card in cards if card.owns]
        if any(card.owns and card.understood(own) for card in cards):
            return None
        return next((card for card in cards if not card.understood(own)), None)

    def _refuse_among(self, foreign: Card) -> None:
        self._refuse(
            f"{_shown(foreign)} uses protocol {foreign.speaks}, this agent"
            f" {protocols(self._protocol)}; install the same armadico on every machine, or use"
            " another namespace: --namespace"
        )

    def _refuse_for(self, rival: str) -> None:
        card = self._cards.get(rival)
        if card is not None and card.name != self._name:
            both = ", ".join(sorted(self._owns.intersection(card.owns)))
            self._refuse(f"{both} has an owner already: {_shown(card)}; end that one first")
            return
        self._refuse(
            f"another {self._name} agent is alive already: {_shown(card) if card else rival};"
            " end that one, or use another namespace: --namespace"
        )

    def _refuse(self, why: str) -> None:
        self.stage, self.refusal = Stage.REFUSED, why


def _shown(card: Card) -> str:
    return f"{card.instance} (host {card.host}, pid {card.pid}, version {card.version})"
