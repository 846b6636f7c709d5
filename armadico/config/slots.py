"""What a capability brings to a society: its slot, by an entry point.

A package registers a `Slot` in the group `armadico.slots`. A capability that is not installed
changes nothing.
"""

from __future__ import annotations

from functools import cache

from msgspec import Struct

from armadico.core.discovery import SLOTS
from armadico.core.installed import left_out, loaded


class Need(Struct, frozen=True, forbid_unknown_fields=True):
    """The agents that one kind of task needs, including those of the tasks in `like`."""

    agents: tuple[str, ...] = ()
    helps: tuple[str, ...] = ()
    """Optional agents of the task."""
    like: tuple[str, ...] = ()
    plans: tuple[str, ...] = ()
    """The plans of scenarios that are this task."""
    errors: bool = False
    """Whether every scenario whose sensors have errors includes this task."""
    missions: bool = False
    """Whether every mission of several tasks includes this task."""
    energy: tuple[str, ...] = ()
    """Missions whose `energy` is one of these include this task."""


class Slot(Struct, frozen=True):
    """The agents that a capability leaves out and adds, and what its tasks need."""

    without: tuple[str, ...] = ()
    besides: tuple[str, ...] = ()
    needs: dict[str, Need] = {}  # by kind of task


@cache
def slots() -> dict[str, Slot]:
    """The installed slots by name."""
    found = {}
    for point, made in loaded(SLOTS):
        if isinstance(made, Slot):
            found[point.name] = made
        else:
            left_out(point, "must be an armadico.config.slots.Slot")
    return found


def slot(name: str) -> Slot:
    """A capability's slot; an empty one if its package is not installed."""
    return slots().get(name, Slot())
