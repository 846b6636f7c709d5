"""Missions of several tasks, as far as a scenario and a run need them.

The mission's file is read by the package that implements missions, found by its entry point in the
group `armadico.missions`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

from armadico.core.config_errors import ConfigError
from armadico.core.discovery import MISSIONS
from armadico.core.installed import loaded
from armadico.mobile.errand import Order

if TYPE_CHECKING:
    from armadico.config.places import Places


class Mission(Protocol):
    @property
    def name(self) -> str: ...

    @property
    def title(self) -> str: ...

    @property
    def text(self) -> str:
        """The text of its file."""

    @property
    def scenario(self) -> str | None:
        """Its default scenario."""

    @property
    def timeout_s(self) -> float | None:
        """Its time limit, s; None: not given."""

    @property
    def energy(self) -> str:
        """The task that comes before a path that the battery is too low for."""

    @property
    def does(self) -> frozenset[str]:
        """The names of all tasks in it."""

    def order(self, priority: float | None, by: str) -> Order:
        """The message that requests it; None: its own priority."""


def load_mission(
    name_or_path: str | Path,
    places: Places | None = None,
    start: tuple[float, float] | None = None,
) -> Mission:
    """A shipped mission by its name, or a file.

    Its places are checked by those of its world, if given, and must be reachable from `start`, m,
    if given. Raises ConfigError if it cannot be read or done, or no package for missions is
    installed.
    """
    for _, load in loaded(MISSIONS):
        return cast("Mission", load(name_or_path, places, start))
    raise ConfigError(f"mission {name_or_path}: no package for missions is installed")
