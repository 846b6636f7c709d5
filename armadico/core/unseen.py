"""The rule for paths through what nobody has seen on a map. It imports nothing, for `--help`."""

from __future__ import annotations

from typing import Final, Literal

Rule = Literal["drive", "refuse"]
DRIVE: Final = "drive"
REFUSE: Final = "refuse"
RULES: Final[tuple[Rule, ...]] = (DRIVE, REFUSE)
"""Whether a path may lead through what nobody has seen, where no other leads to the goal."""
