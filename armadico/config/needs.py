"""Which agents a task cannot do without: the table that hosts are started and watched by."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Final

from msgspec import Struct

from armadico.config.errors import ConfigError, advice
from armadico.config.lines import line_of
from armadico.config.loading import document, parse_entries, read_text
from armadico.config.scenarios import Scenario, planned, society
from armadico.config.shipped import folder

TABLE: Final = "needs.toml"

ROOMS: Final = "rooms"
DIRECT: Final = "direct"
"""Plans of scenarios that say none."""


class Need(Struct, frozen=True, forbid_unknown_fields=True):
    """What one kind of task needs: its own agents, and those of the tasks that it is like."""

    agents: tuple[str, ...] = ()
    like: tuple[str, ...] = ()
    plans: tuple[str, ...] = ()
    """A scenario's plans that are this task."""
    errors: bool = False
    """Whether every scenario whose sensors have errors is this, too."""


@cache
def table(file: Path | None = None) -> dict[str, Need]:
    """The needs by kind of task, shipped or of a file. Raises ConfigError with file and line."""
    path = file or folder("") / TABLE
    text = read_text(path)
    found = parse_entries(document(text, path), Need, path, text)
    for kind, need in found.items():
        for index, other in enumerate(need.like):
            if other not in found:
                message = f"{kind}.like[{index}]: no task {other!r}; {advice(other, found)}"
                raise ConfigError(message, path, line_of(text, (kind, "like", index)))
    return found


def needs(tasks: Iterable[str], file: Path | None = None) -> tuple[str, ...]:
    """The agents that tasks of these kinds cannot do without, the robot agent first, each once.

    Raises ConfigError with the nearest kind for one that the table does not have.
    """
    known = table(file)
    kinds: dict[str, None] = {}
    for task in tasks:
        if task not in known:
            raise ConfigError(f"no needs of a task {task!r}; {advice(task, known)}")
        kinds |= dict.fromkeys(_with_likes(task, known, frozenset()))
    agents = (agent for kind in kinds for agent in known[kind].agents)
    return tuple(dict.fromkeys((society().robot, *agents)))


def _with_likes(kind: str, known: dict[str, Need], above: frozenset[str]) -> Iterator[str]:
    """A kind of task after all that it is like; of a circle each once."""
    if kind in above:
        return
    for other in known[kind].like:
        yield from _with_likes(other, known, above | {kind})
    yield kind


def tasks(scenario: Scenario | None) -> tuple[str, ...]:
    """The kinds of task that a scenario is; without one the robot may be sent anywhere."""
    plan = ROOMS if scenario is None else scenario.plan
    if scenario is not None and plan is None:
        plan = ROOMS if planned(scenario) else DIRECT
    exact = scenario is not None and scenario.sensors == society().ideal.sensors
    return tuple(
        kind for kind, need in table().items() if plan in need.plans or (need.errors and not exact)
    )
