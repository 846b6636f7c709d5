"""What of an agent a file or ``--set KEY=VALUE`` may change."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

TURN_MARGIN_M = 0.02
"""Kept by a robot that is slow, or turns on the spot, where no parameters say it."""


class Social(Struct, frozen=True, forbid_unknown_fields=True):
    """Parameters of the social intelligence, the same for every agent."""

    exchange: Literal["smooth", "abrupt"] | None = None  # None: the resource's own
    margin: Annotated[float, Meta(ge=0, le=1)] | None = None  # None: the resource's own
    comparison: Literal["same-cycle", "last-heard"] = "same-cycle"  # the latter is the thesis's


class Safety(Struct, frozen=True, forbid_unknown_fields=True):
    """Margins around the body. How it brakes is the robot's own, and comes with its description."""

    margin_m: Annotated[float, Meta(ge=0, le=1)] = 0.08
    slow: Annotated[float, Meta(ge=0, le=1)] = 0.0  # m/s: at no more than this
    close_m: Annotated[float, Meta(ge=0, le=1)] = TURN_MARGIN_M  # so small a margin will do
    turn_room: Annotated[float, Meta(ge=0, le=3.2)] = 0.12  # rad free, or it tries the other side
    unmapped: bool = False  # by sonars without a map: stops within the way to the nearest point


class Parameters(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a file or ``--set KEY=VALUE`` may change; subclasses add their own."""

    social: Social = Social()
