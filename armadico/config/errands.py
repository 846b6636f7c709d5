"""Missions of several tasks, as far as a scenario and a run have to know them.

What a mission's file says is for the package that does missions, which is found by its entry point
in the group `armadico.missions`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

from armadico.config.discovery import MISSIONS, installed
from armadico.config.errors import ConfigError
from armadico.mobile.errand import Order

if TYPE_CHECKING:
    from armadico.config.places import Places


class Mission(Protocol):
    """A mission as it was read."""

    @property
    def name(self) -> str:
        """What it is called."""

    @property
    def title(self) -> str:
        """What it does, for people."""

    @property
    def text(self) -> str:
        """Its file."""

    @property
    def scenario(self) -> str | None:
        """Where it is driven unless that is said."""

    @property
    def timeout_s(self) -> float | None:
        """What it may take, s; None: that is not said."""

    @property
    def energy(self) -> str:
        """What is done before a way that the battery will not do for."""

    @property
    def does(self) -> frozenset[str]:
        """The names of all tasks that it may do."""

    def order(self, priority: float | None, by: str) -> Order:
        """What asks for it; without a priority it has its own."""


def load_mission(
    name_or_path: str | Path,
    places: Places | None = None,
    start: tuple[float, float] | None = None,
) -> Mission:
    """A shipped mission by its name, or a file.

    Args:
        name_or_path: Which.
        places: Those of the world that it is for; None: its places are not looked up.
        start: From where they must be got to, m; None: that is not looked at.

    Raises:
        ConfigError: It cannot be read or done, or no package is installed that does missions.
    """
    for found in installed(MISSIONS).values():
        return cast("Mission", found.load()(name_or_path, places, start))
    raise ConfigError(f"mission {name_or_path}: no package that does missions is installed")
