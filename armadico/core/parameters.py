"""The parameters of agents that a file or ``--set KEY=VALUE`` may change."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from msgspec import Meta, Struct

TURN_MARGIN_M = 0.02  # default margin of a robot that is slow or turns in place


class Social(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of the social intelligence, the same for every agent."""

    exchange: Literal["smooth", "abrupt"] | None = None  # None: the resource's own
    margin: Annotated[float, Meta(ge=0, le=1)] | None = None  # None: the resource's own
    comparison: Literal["same-cycle", "last-heard"] = "same-cycle"  # the latter is the thesis's
    coordination: str | None = None  # installed mechanisms, with commas; None: ballots
    # With an arbiter: what an agent's share is; None: the mechanism's own
    told: Literal["award", "yes", "no"] | None = None
    utility: Annotated[tuple[float, ...], Meta(max_length=32)] = ()  # weights of a learned one


class Safety(Struct, frozen=True, forbid_unknown_fields=True):
    """Margins around the footprint. The braking ramps come with the robot's description."""

    margin_m: Annotated[float, Meta(ge=0, le=1)] = 0.08
    slow: Annotated[float, Meta(ge=0, le=1)] = 0.0  # m/s: up to this speed, `close_m` is the margin
    close_m: Annotated[float, Meta(ge=0, le=1)] = TURN_MARGIN_M
    turn_room: Annotated[float, Meta(ge=0, le=3.2)] = 0.12  # rad free, else the other side is tried
    unmapped: bool = False  # sonars without a map: it stops within the nearest point's distance


class Parameters(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An agent's parameters; subclasses add their own."""

    social: Social = Social()


@dataclass(frozen=True)
class Naming:
    """Marks a parameter's text in which agents are named; `names` reads them from it."""

    names: Callable[[str], Iterable[str]]


def _itself(text: str) -> tuple[str]:
    return (text,)


AgentName = Annotated[str, Naming(_itself)]
"""A parameter, or an item or a key of one, that is the name of an agent. A name of none has no
effect, so a launcher refuses it and an arbiter reports it (`names_set`)."""


def agents_named(value: object, hint: Any = None, at: str = "") -> Iterator[tuple[str, str]]:
    """Yield each agent that a value names, after the parameter in which it does, such as `wires`.

    The value is parameters, or a part of them at `at`, with its annotation unless it is a struct.
    """
    if isinstance(value, Struct):
        hints = get_type_hints(type(value), include_extras=True)
        for name in value.__struct_fields__:
            yield from agents_named(getattr(value, name), hints[name], at or name)
        return
    if get_origin(hint) is Annotated:
        for mark in hint.__metadata__:
            if isinstance(mark, Naming):
                yield from ((at, name) for name in mark.names(str(value)))
        hint = hint.__origin__
    inner = get_args(hint)
    if isinstance(value, tuple) and inner:
        for each in value:
            yield from agents_named(each, inner[0], at)
    elif isinstance(value, dict) and inner:
        for key, each in value.items():
            yield from agents_named(key, inner[0], at)
            yield from agents_named(each, inner[1], at)


def names_set(value: Parameters) -> dict[str, str]:
    """Return the agents that a setting names and the defaults do not, with the parameter of each.

    A default names every agent that it has a place for, whether it takes part or not.
    """
    usual = {name for _, name in agents_named(type(value)())}
    return {name: at for at, name in agents_named(value) if name not in usual}
