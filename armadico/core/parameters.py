"""The parameters of agents that a file or ``--set KEY=VALUE`` may change."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

TURN_MARGIN_M = 0.02  # default margin of a robot that is slow or turns in place


class Social(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of the social intelligence, the same for every agent."""

    exchange: Literal["smooth", "abrupt"] | None = None  # None: the resource's own
    margin: Annotated[float, Meta(ge=0, le=1)] | None = None  # None: the resource's own
    comparison: Literal["same-cycle", "last-heard"] = "same-cycle"  # the latter is the thesis's
    coordination: str | None = None  # an installed mechanism for the wheels; None: ballots
    told: Literal["award", "yes", "no"] = "award"  # with an arbiter: what an agent's share is


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
