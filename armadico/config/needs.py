"""The agents that each kind of task needs: a table for starting and watching hosts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache
from typing import Final

from armadico.config.loading import load_table
from armadico.config.scenarios import Scenario, mission_of, planned, society
from armadico.config.shipped import folder
from armadico.config.slots import Need, needs_of_slots
from armadico.core.config_errors import ConfigNameError

TABLE: Final = "needs.toml"

ROOMS: Final = "rooms"
DIRECT: Final = "direct"
"""The plans of scenarios that name none: with and without walls."""


@cache
def table() -> dict[str, Need]:
    """The needs by kind of task: the shipped ones with those of slots."""
    found = load_table(folder("") / TABLE, Need)
    return found | needs_of_slots(found)


def needs(tasks: Iterable[str], *, helps: bool = False) -> tuple[str, ...]:
    """The agents that tasks of these kinds need, the robot agent first, each once.

    `helps`: with the optional agents, which is the least society for these tasks. Raises
    ConfigNameError for a kind that the table does not have.
    """
    return tuple(dict.fromkeys((society().robot, *_agents(tasks, helps=helps))))


def _agents(tasks: Iterable[str], *, helps: bool) -> Iterator[str]:
    known = table()
    for task in tasks:
        if task not in known:
            raise ConfigNameError("task", task, known)
        for kind in _with_likes(task, known, frozenset()):
            yield from known[kind].agents
            if helps:
                yield from known[kind].helps


def _with_likes(kind: str, known: dict[str, Need], above: frozenset[str]) -> Iterator[str]:
    """A kind of task after all kinds that it is like, each once."""
    if kind in above:
        return
    for other in known[kind].like:
        yield from _with_likes(other, known, above | {kind})
    yield kind


def tasks(scenario: Scenario | None) -> tuple[str, ...]:
    """The kinds of task of a scenario and its mission; None: a society without a scenario.

    A task that is not in the table, of another package, needs what every mission needs.
    """
    mission = None if scenario is None else mission_of(scenario)
    plan, done = None, frozenset[str]()
    if mission is not None:
        done = mission.does
    elif scenario is None:
        plan = ROOMS
    else:
        plan = scenario.plan or (ROOMS if planned(scenario) else DIRECT)
    exact = scenario is not None and scenario.sensors == society().ideal.sensors

    def is_one(kind: str, need: Need) -> bool:
        if plan in need.plans or (need.errors and not exact):
            return True
        if mission is None:
            return False
        return kind in done or need.missions or mission.energy in need.energy

    return tuple(kind for kind, need in table().items() if is_one(kind, need))
