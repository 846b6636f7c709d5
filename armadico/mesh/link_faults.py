"""What is wrong with a link between two processes or hosts: one description for every network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class LinkFaults:
    """What is wrong with one direction of a link; by default nothing.

    Times are s, shares of what is sent from 0 to 1. What is sent keeps its order but for the share
    `reorder`.

    The virtual network carries messages: `jitter` comes on top of `delay`, what is duplicated or
    reordered is late by up to `behind`, and `garble` is the share of pieces of bytes that arrive
    spoilt. The laboratory's switch carries Ethernet frames: it cuts, loses and delays them, by
    `delay` give or take up to `jitter`.
    """

    cut: bool = False
    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    behind: float = 0.0
    garble: float = 0.0


WHOLE: Final = LinkFaults()
