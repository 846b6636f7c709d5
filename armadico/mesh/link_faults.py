"""Faults of a link between two processes or hosts, for all simulated networks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class LinkFaults:
    """Faults of one direction of a link; by default none.

    Times are s; shares are 0 to 1. Order is kept except for the share `reorder`.

    On the virtual network, which carries messages, `jitter` is added to `delay`. Duplicates and
    reordered messages are late by up to `behind`; `garble` is the share of byte chunks that arrive
    corrupted. The laboratory's switch, which carries Ethernet frames, cuts, loses and delays them,
    by `delay` plus or minus up to `jitter`.
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
