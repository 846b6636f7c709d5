"""What a chronicle answers (sans-IO): structs for programs, sentences and a cause for people."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec import Struct

from armadico.core.membership import agent_of
from armadico.observe.findings import Finding, Sort, cause
from armadico.observe.journeys import Journey
from armadico.observe.standing import Standing
from armadico.watch.drives import Drive, Unobeyed


class Input(Struct, frozen=True):
    """An input of a bid: the newest state on a key, and its age at that time."""

    key: str
    age: int | None  # cycles; none: of another epoch, or without a cycle
    what: str


class Bidding(Struct, frozen=True):
    """The bid of one contender, with its inputs."""

    agent: str
    instance: str
    host: str
    cycle: int | None = None  # that its bid answers; none: it was not queried in time
    utility: float | None = None  # none: it has no bid, for the reason
    critical: bool = False
    wanted: tuple[float, ...] = ()  # empty for an action without numbers
    reason: str = ""
    inputs: tuple[Input, ...] = ()


class Contest(Struct, frozen=True):
    """One resource at one moment: its holder, the action, and the other contenders' bids."""

    resource: str
    holder: str = ""  # the instance that claims it; empty: none
    term: int | None = None
    utility: float | None = None
    critical: bool = False
    wanted: tuple[float, ...] = ()
    commanded: tuple[float, ...] = ()
    loser: str = ""  # the previous holder, during an exchange; else empty
    obeyed: str = ""  # the instance that its owner obeys; empty: none
    measured: tuple[float, ...] = ()
    refused: tuple[str, ...] = ()  # commands that the owner refused recently
    bids: tuple[Bidding, ...] = ()


class Moment(Struct, frozen=True):
    """The state of the society at a time, s of the observer's clock."""

    t: float
    cycle: int | None
    stands: bool
    contests: tuple[Contest, ...]
    sentences: tuple[str, ...]
    cause: Finding | None


class Exchange(Struct, frozen=True):
    """A change of the agent that a resource obeys; counted from 1 for each resource."""

    number: int
    t: float
    cycle: int
    resource: str
    loser: str
    winner: str
    cycles: int  # in which the winner's action was blended with the loser's
    sentences: tuple[str, ...]
    cause: Finding
    bids: tuple[Bidding, ...]


class Press(Struct, frozen=True):
    """A stop that was latched; counted from 1. Times are s; none: it did not happen."""

    number: int
    t: float
    by: str
    stood: float | None  # s after it the robot stood
    released: float | None
    released_by: str
    sentences: tuple[str, ...]
    cause: Finding


class Collision(Struct, frozen=True):
    """A contact of the robot with an obstacle; counted from 1."""

    number: int
    t: float
    sentences: tuple[str, ...]
    cause: Finding
    moment: Moment


class Summary(Struct, frozen=True):
    """A whole recording; its length is in s.

    Of events that were not all counted, by `unknown`, those that are known are a lower bound; None:
    none is known.
    """

    seconds: float
    exchanges: list[Exchange] | None
    stops: list[Press] | None
    collisions: list[Collision] | None
    drives: list[Drive]
    unobeyed: Unobeyed | None
    standing: Standing
    sentences: tuple[str, ...]
    journeys: list[Journey] = []
    mechanisms: tuple[str, ...] = ()  # what decided who drives, by the agents' cards
    unknown: dict[str, str] = {}  # by "exchange", "stop" or "collision", why not all are known


Event = Exchange | Press | Collision
Answer = Moment | Event | Summary | Standing


# In words -----------------------------------------------------------------------------------------


def describe_contest(of: Contest) -> Iterator[str]:
    name = of.resource
    if of.holder:
        rank = f"{of.utility:.2f}{', critical' if of.critical else ''}"
        text = f"{name}: {agent_of(of.holder)} holds it (term {of.term}) with {rank}"
        if of.wanted:
            text += f", wants {_pair(of.wanted)}"
        if of.loser:
            text += (
                f" and commands {_pair(of.commanded)}, still blended with {agent_of(of.loser)}'s"
            )
        yield text + "."
    elif of.bids or of.obeyed:
        yield f"{name}: no agent claims it."
    if of.obeyed and of.obeyed != of.holder:
        yield f"Its owner obeys {agent_of(of.obeyed)}."
    elif of.holder and not of.obeyed:
        yield "Its owner obeys no agent."
    for refusal in of.refused:
        yield f"Its owner reports: {refusal}."
    for each in of.bids:
        yield describe_bid(each)
    by_inputs: dict[tuple[Input, ...], list[str]] = {}
    for each in of.bids:
        if each.inputs:
            by_inputs.setdefault(each.inputs, []).append(each.agent)
    for inputs, agents in by_inputs.items():
        made = "; ".join(f"{i.key} {i.what}{_old(i.age)}" for i in inputs)
        yield f"{', '.join(agents)}: inputs {made}."


def missing_bids(answer: Moment | Exchange | Collision) -> set[str]:
    """The instances whose bids an answer lacks, because they were not queried in time."""
    moment = answer.moment if isinstance(answer, Collision) else answer
    contests = moment.contests if isinstance(moment, Moment) else (moment,)
    return {bid.instance for each in contests for bid in each.bids if bid.cycle is None}


def describe_bid(of: Bidding) -> str:
    """A contender's bid in a sentence."""
    if of.cycle is None:
        return f"{of.agent} computed no bid, or was not queried in time."
    if of.utility is None:
        return f"{of.agent} had no bid: {of.reason or 'no reason given'}."
    critical = ", critical" if of.critical else ""
    why = f" ({of.reason})" if of.reason else ""
    to = f" for {_pair(of.wanted)}" if of.wanted else ""
    return f"{of.agent} bid {of.utility:.2f}{critical}{to}{why}."


def outbid(of: Contest) -> Finding | None:
    """The best contender below the holder, as a cause; None if there is no other bid."""
    others = [b for b in of.bids if b.utility and b.instance != of.holder]
    if not of.holder or not others:
        return None
    best = max(others, key=lambda b: (b.utility or 0.0, b.critical))
    holder = agent_of(of.holder)
    what = f"{best.agent}'s bid of {best.utility:.2f} does not exceed {holder}'s {of.utility:.2f}."
    return cause(Sort.OUTBID, holder, what)


def _old(age: int | None) -> str:
    return f", {age} cycles old" if age is not None and age > 1 else ""


def _pair(action: tuple[float, ...]) -> str:
    return f"({', '.join(f'{each:.2f}' for each in action)})"
