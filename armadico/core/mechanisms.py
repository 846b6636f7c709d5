"""The seam for coordination mechanisms: what decides which bid a resource follows.

The default is `Contender`: ballots, with nobody in charge. Another mechanism is an object named by
an entry point in the group `armadico.coordinations`. Both are protocols, not base classes. A
coordination decides about the resources that it knows: the wheels, the trajectory, a task between
robots, or a third party's own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.util import find_spec
from random import Random
from typing import Final, Protocol

from armadico.core import messages as m
from armadico.core.config_errors import ConfigError, ConfigNameError
from armadico.core.coordination import COMPARISONS, Compare, Contender
from armadico.core.cycles import CycleClock
from armadico.core.exchange import EXCHANGES, Bid, Exchange
from armadico.core.individual import Individual
from armadico.core.installed import left_out, loaded
from armadico.core.messages import BALLOTS, Message
from armadico.core.resources import WHEELS, Resource

Terms = tuple[Resource, str, CycleClock, Exchange, Random, float | None, Compare]
"""The arguments of a `Contender`."""

GROUP: Final = "armadico.coordinations"


class Mechanism(Protocol):
    """The contender's side of one resource, as the kernel of an agent calls it (sans-IO).

    Each call returns the messages to publish, of kinds whose keys name the resource.
    """

    @property
    def receives(self) -> tuple[type[Message], ...]:
        """The kinds of messages that it needs besides claims and acks; each names its resource."""

    @property
    def ack(self) -> m.Ack | None:
        """The owner's newest ack."""

    @property
    def owned(self) -> bool:
        """Whether the resource has an owner: its ack is fresh."""

    @property
    def holding(self) -> bool:
        """Whether the agent itself holds the resource."""

    @property
    def share(self) -> float:
        """How much of the resource's command is this agent's, 0 to 1."""

    @property
    def speaker(self) -> str:
        """The instance whose commands carry the agent's bids: its own, or an arbiter's, or ""."""

    @property
    def wakeup(self) -> float | None:
        """When `tick` is due, s; None: not at all."""

    def bid(
        self, cycle: m.Cycle, bid: Bid | None, now: float, inputs: m.Cycle | None = None
    ) -> list[Message]:
        """Process this cycle's bid, or None; `inputs` is the cycle of its oldest input."""

    def on_claim(self, claim: m.Claim, now: float) -> list[Message]:
        """Process another contender's claim or release."""

    def on_message(self, message: Message, now: float) -> list[Message]:
        """Process a message of one of `receives`, of this resource."""

    def acked(self, ack: m.Ack, now: float) -> list[Message]:
        """Process the owner's ack."""

    def gone(self, instance: str, now: float) -> list[Message]:
        """Process the end of an instance's liveliness token."""

    def returned(self, now: float) -> None:
        """Discard what belongs to cycles that the clock no longer counts."""

    def tick(self, now: float) -> list[Message]:
        """Process a wake-up."""


class Coordination(Protocol):
    """A mechanism as an entry point names it.

    It may have more attributes. `needs` is the name of a method that each agent which competes for
    the wheels must have, and `library` a module that must be installed. `sets` are the arbiter's
    parameters, KEY=VALUE. `resource` is what it decides about: a resource, or how the names of
    resources begin that exist only later; two that have the same one are refused, and so is one
    that no agent competes for. `lacking` is a method that gets all agents which compete for
    something, and returns why it would decide nothing with their settings, "" if it would. For
    people `about` says what decides, `without` what it leaves out of its model, and `where` which
    society has something for it to decide. `absent` says why a name is none that can be chosen.
    """

    @property
    def arbiter(self) -> str:
        """The name of its installed agent that decides; empty if it has none."""

    def contender(
        self, resource: Resource, agent: Individual, clock: CycleClock
    ) -> Mechanism | None:
        """Return the contender's side for an agent.

        None: ballots, as for the arbiter itself, and for resources that it does not decide about.
        """


def all_coordinations() -> dict[str, Coordination]:
    """Return the installed coordinations by name; what cannot be loaded or chosen is left out."""
    return {name: each for name, each in _named().items() if not getattr(each, "absent", "")}


def _named() -> dict[str, Coordination]:
    """Return all names of coordinations, those included that cannot be chosen.

    An entry point names one, or a mapping with several by their names. The shipped ones are in such
    a mapping, and come first, so no other package takes the name of one of them.
    """
    found: dict[str, Coordination] = {}
    for point, named in loaded(GROUP):
        several = named if isinstance(named, Mapping) else {point.name: named}
        for name, one in several.items():
            if not (isinstance(getattr(one, "arbiter", None), str) and hasattr(one, "contender")):
                left_out(point, f"{name} is no coordination, see armadico.core.mechanisms")
            elif found.setdefault(name, one) is not one:
                left_out(point, f"there is another coordination {name!r}")
    return found


def coordination(name: str) -> Coordination:
    """Return an installed coordination. Raises ConfigNameError."""
    named = _named()
    known = [each for each, it in named.items() if not getattr(it, "absent", "")]
    if name not in named:
        raise ConfigNameError("coordination", name, known)
    if absent := getattr(named[name], "absent", ""):
        text = f"--coordination {name}: {absent}"
        raise ConfigNameError("coordination", name, known, message=text)
    return named[name]


def lacks(found: Coordination, agents: Mapping[str, type[Individual]]) -> str:
    """Return what a coordination needs and lacks; "" if nothing.

    Args:
        found: The coordination.
        agents: The agents that compete for the wheels, by name.
    """
    library, needs = getattr(found, "library", ""), getattr(found, "needs", "")
    if library and find_spec(library) is None:
        return f"it needs the library {library}: pip install 'armadico[rivals]'"
    for name, cls in agents.items() if needs else ():
        if name != found.arbiter and not callable(getattr(cls, needs, None)):
            return (
                f"it needs a method {needs!r} of each agent that drives, and {name} has none; leave"
                f" it out (--without {name}), or derive it from armadico.Behaviour"
            )
    return ""


def decides(found: Coordination) -> str:
    """Return the name of what a coordination decides about, or how it begins; "": not declared."""
    about = getattr(found, "resource", "")
    return str(getattr(about, "name", about) or "")


def idle(
    found: Coordination, agents: Mapping[str, type[Individual]] | Mapping[str, Individual]
) -> str:
    """Return why a coordination has nothing to decide in a society; "" if it has, or may have.

    Silence would count as success: nobody proposes, so nothing is done wrong.

    Args:
        found: The coordination.
        agents: All agents that take part, on all hosts, by name: their classes, or instances, which
            know more.
    """
    about, arbiter = decides(found), found.arbiter
    if not about or any(name != arbiter and about in rivalled(cls) for name, cls in agents.items()):
        return ""
    where = getattr(found, "where", "")
    return f"no agent here competes for what it decides about, {about}{where and '; ' + where}"


def rivalled(agent: type[Individual] | Individual) -> set[str]:
    """Return the names of all that an agent competes for, or how they begin."""
    return {*(resource.name for resource in agent.competes_for), *agent.competes_later}


def vain(found: Coordination, agents: Mapping[str, Individual]) -> str:
    """Return why a coordination decides nothing among these agents; "" if it decides something.

    Args:
        found: The coordination.
        agents: All agents that compete for something, by name.

    Raises ConfigError if an agent has settings that the coordination refuses.
    """
    lacking: Callable[[Mapping[str, Individual]], str] | None = getattr(found, "lacking", None)
    if why := idle(found, agents) or (lacking(agents) if lacking is not None else ""):
        return why
    for agent in agents.values():
        for _, resource in _contested(agent):
            if found.contender(resource, agent, CycleClock(resource.period_s or 0.1)) is not None:
                return ""
    return (
        f"its contender() returns None for all that {', '.join(agents)} compete for, so all would"
        " go on by ballots"
    )


def _contested(agent: Individual) -> Iterator[tuple[str, Resource]]:
    """Yield what an agent competes for by its name in `rivalled`, or an example of it."""
    for resource in agent.competes_for:
        yield resource.name, resource
    for name in agent.competes_later:
        yield name, Resource(f"{name}0", ("x",), (1.0,), (0.0,))


def differing(agents: Mapping[str, Individual]) -> str:
    """Return a sentence about agents that compete for one thing by different mechanisms; or "".

    Raises ConfigError as `chosen`.
    """
    by: dict[str, dict[str, list[str]]] = {}
    for name, agent in agents.items():
        for about, resource in _contested(agent):
            # A setting may name several, of which not all decide about this resource.
            decided_by, _ = chosen(resource, agent, CycleClock(resource.period_s or 0.1))
            by.setdefault(about, {}).setdefault(decided_by, []).append(name)
    return next((mixture(name, sides) for name, sides in by.items() if len(sides) > 1), "")


def coordinations(names: str | None) -> dict[str, Coordination]:
    """Return installed coordinations by their names, which commas separate; None: of none.

    Raises ConfigNameError.
    """
    return {name: coordination(name) for name in ([] if names is None else names.split(","))}


def preset_of(names: str | None) -> dict[str, tuple[str, ...]]:
    """Return the parameters of chosen coordinations, KEY=VALUE, by the name of their arbiter."""
    return {
        each.arbiter: tuple(getattr(each, "sets", ())) for each in coordinations(names).values()
    }


def chosen(
    resource: Resource, agent: Individual, clock: CycleClock
) -> tuple[str, Mechanism | None]:
    """Return the chosen mechanism's name and its contender's side of a resource for an agent.

    By ballots that is None, as it is for an arbiter, whose mechanism is the one that it decides by.
    Raises ConfigError if two mechanisms decide about the resource, or one is not installed.
    """
    known = coordinations(agent.p.social.coordination)
    found = {name: each.contender(resource, agent, clock) for name, each in known.items()}
    sides = [(name, side) for name, side in found.items() if side is not None]
    if len(sides) > 1:
        both = " and ".join(name for name, _ in sides)
        raise ConfigError(f"--coordination: {both} both decide about {resource.name}")
    own = (name for name, each in known.items() if each.arbiter == agent.name)
    return sides[0] if sides else (next(own, BALLOTS), None)


def contender(resource: Resource, agent: Individual, clock: CycleClock) -> tuple[str, Mechanism]:
    """Return the same; where no other mechanism is chosen, the side by ballots."""
    name, side = chosen(resource, agent, clock)
    if side is not None:
        return name, side
    return name, Contender(*terms(resource, agent, clock))


def terms(resource: Resource, agent: Individual, clock: CycleClock) -> Terms:
    """Return what a contender by ballots is built of, by the agent's settings."""
    social = agent.p.social
    exchange = EXCHANGES[social.exchange or resource.exchange]
    compare = COMPARISONS[social.comparison]
    return resource, agent.instance, clock, exchange, agent.rng, social.margin, compare


def deciding(cards: Iterable[m.Card]) -> tuple[str, ...]:
    """Return the names of the mechanisms by which some agents compete for the wheels, sorted."""
    return tuple(
        sorted({card.mechanism_of(WHEELS.name) for card in cards if WHEELS.name in card.resources})
    )


def mixed(cards: Iterable[m.Card]) -> dict[str, dict[str, list[str]]]:
    """Return, of each resource with several mechanisms, the competing instances by mechanism."""
    found: dict[str, dict[str, list[str]]] = {}
    for card in cards:
        for name in card.resources:
            found.setdefault(name, {}).setdefault(card.mechanism_of(name), []).append(card.instance)
    return {name: by for name, by in found.items() if len(by) > 1}


def mixture(resource: str, by: Mapping[str, Iterable[str]]) -> str:
    """Return a sentence about a resource with several mechanisms."""
    sides = "; ".join(f"by {name}: {', '.join(sorted(by[name]))}" for name in sorted(by))
    return f"agents compete for {resource} by different mechanisms ({sides})"
