"""What a capability brings to a society: its slot, by an entry point.

A package registers a `Slot` in the group `armadico.slots`. A capability that is not installed
changes nothing.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from importlib.metadata import EntryPoint

import msgspec
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
def _slots() -> dict[EntryPoint, Slot]:
    found = {}
    for point, made in loaded(SLOTS):
        if not isinstance(made, Slot):
            left_out(point, "must be an armadico.config.slots.Slot")
            continue
        try:  # its fields are not checked when it is made
            found[point] = msgspec.convert(msgspec.to_builtins(made), Slot)
        except (TypeError, msgspec.ValidationError) as error:
            left_out(point, str(error))
    return found


def slot(name: str) -> Slot:
    """A capability's slot; an empty one if its package is not installed."""
    return next((slot for point, slot in _slots().items() if point.name == name), Slot())


def needs_of_slots(kinds: Collection[str]) -> dict[str, Need]:
    """What slots add to the needs of these kinds of tasks, without rows that cannot be used."""
    found: dict[str, tuple[EntryPoint, Need]] = {}
    for point, slot in _slots().items():
        for kind, need in slot.needs.items():
            if kind in kinds or kind in found:
                left_out(point, f"its need {kind!r} exists")
            else:
                found[kind] = point, need
    while lost := {k for k, (_, need) in found.items() if {*need.like} - {*kinds, *found}}:
        for kind in lost:
            point, need = found.pop(kind)
            left_out(point, f"its need {kind!r} is like {need.like}, which are not all there")
    return {kind: need for kind, (_, need) in found.items()}
