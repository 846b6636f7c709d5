"""Runs attacks, one after another, each on a society that works."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Final, NamedTuple

import zenoh

from armadico_tools.attacks.attempts import DRIVES, STOPPED, Attempt
from armadico_tools.attacks.peer import Peer
from armadico_tools.attacks.victim import Victim
from armadico_tools.testbed import PlaceError

if TYPE_CHECKING:
    from armadico_tools.attacks.strangers import Stranger

TRIES: Final = 5
"""A member's attempts to get a link, as a busy computer may not answer within Zenoh's timeout."""

Report = Callable[[str], None]


class Outcome(NamedTuple):
    """What one attack did.

    Attributes:
        who: The attacker: a member's name, or how it is a stranger.
        name: The attack; "link" if it only tried to get one.
        linked: Whether it got a link.
        effects: In words; empty if there were none.
    """

    who: str
    is_stranger: bool
    name: str
    linked: bool
    effects: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        if not self.linked:
            return "no link"
        return "; ".join(self.effects) or "no effect"


def run(
    chosen: Sequence[Attempt],
    members: Sequence[str],
    seconds: float,
    *,
    keys: bool,
    links: bool,
    report: Report,
) -> Iterator[Outcome]:
    """Yield the outcome of each attack. Raises PlaceError if the society does not come up."""
    report(f"starting a society {'with' if keys else 'without'} keys")
    with Victim(keys=keys) as victim:
        if links or (keys and not members):
            yield from _links(victim)
        if not links:
            _record(victim, report)
            for name in members or ("",):
                yield from _attacks(victim, chosen, seconds, name)


def _record(victim: Victim, report: Report) -> None:
    """Keep a drive, a stop and its release as the recording of another day."""
    report("recording a drive, a stop and its release")
    for state in (DRIVES, STOPPED, DRIVES):
        victim.bring(state)
    victim.keep_tape()
    victim.restart()


def _links(victim: Victim) -> Iterator[Outcome]:
    from armadico_tools.attacks.strangers import member, strangers

    if not linked(victim, member(victim, "goto"), TRIES):
        raise PlaceError("the rightful member goto gets no link, so a stranger proves nothing")
    for stranger in strangers(victim):
        yield Outcome(stranger.name, True, "link", linked(victim, stranger))


def link(
    namespace: str, endpoint: str, settings: Mapping[str, object], tries: int = TRIES
) -> Peer | None:
    """Return a link as a peer, or None if each try failed."""
    for _ in range(tries):
        with suppress(zenoh.ZError):
            return Peer(namespace, endpoint, settings)
    return None


def linked(victim: Victim, who: Stranger, tries: int = 1) -> bool:
    """Whether a peer gets a link that lasts: TLS 1.3 refuses a client after its first bytes."""
    peer = link(victim.namespace, who.endpoint, who.settings, tries)
    if peer is None:
        return False
    with peer:
        victim.settle()
        with suppress(zenoh.ZError):
            return bool(peer.tokens("**")) or peer.is_linked
    return False


def _attacks(
    victim: Victim, chosen: Sequence[Attempt], seconds: float, name: str
) -> Iterator[Outcome]:
    """Make the attempts, as a stranger with what a stranger has, or as a member."""
    settings: Mapping[str, object] = {}
    if name:
        from armadico_tools.attacks.strangers import member

        settings = member(victim, name).settings
        victim.known.me = name
    who = name or "a stranger"
    for attempt in chosen:
        peer = link(victim.namespace, victim.endpoint, settings, TRIES if name else 1)
        if peer is None:
            yield Outcome(who, not name, attempt.name, False)
            continue
        with peer:
            effects = victim.attacked(attempt, peer, seconds)
        yield Outcome(who, not name, attempt.name, True, tuple(effects))
        if any("read" not in effect for effect in effects):
            victim.restart()
