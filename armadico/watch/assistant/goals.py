"""Which goal is a client's own: the last one that was accepted, or one that is driven for it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Final

from armadico.core.latched import Memory
from armadico.core.messages import line
from armadico.mobile.errand import Errands, Progress
from armadico.mobile.messages import Trajectory
from armadico.watch.assistant.messages import AssistantRequest

# The prefix of the name under which the assistant agent orders missions and stops the robot.
BY: Final = "assistant"

LONGEST_BY: Final = 100  # characters of that name that are published

CLIENTS: Final = 64  # clients whose own goal is known

KEPT: Final = 8  # goals of each, of which a late trajectory may be


class Goals:
    """The goals of clients, by what mission agents replied and what is driven.

    A reply may be lost, so a goal may be driven whose number nobody has told.
    """

    def __init__(self, memory: Memory) -> None:
        """`memory` has the trajectory and the boards of mission agents."""
        self._memory = memory
        self._accepted: dict[str, deque[int]] = {}  # by client, the last one at the end
        self._allowed: dict[int, tuple[str, ...]] = {}  # rooms that were approved, by mission
        self._lost: dict[str, AssistantRequest] = {}  # cancelled without a reply, by orderer

    def accept(self, client: str, number: int) -> None:
        """Note that a client's goal was accepted with a number."""
        self._accepted.setdefault(client, deque(maxlen=KEPT)).append(number)
        for each in [*self._accepted][:-CLIENTS]:
            del self._accepted[each]

    def allow(self, mission: int, rooms: tuple[str, ...]) -> None:
        """Note the rooms through which a person has approved the way of a mission."""
        self._allowed[mission] = rooms
        for each in [*self._allowed][:-CLIENTS]:
            del self._allowed[each]

    def allowed(self, trajectory: Trajectory, begins: tuple[str, ...]) -> tuple[str, ...]:
        """The rooms that were approved for what is driven, or `begins` if it is not known yet."""
        return self._allowed.get(self.number_of(trajectory), begins)

    def client_of(self, number: int) -> str | None:
        """The client whose last goal has a number; None: nobody's."""
        last = ((client, numbers[-1]) for client, numbers in self._accepted.items())
        return next((client for client, each in last if each == number), None)

    def of(self, request: AssistantRequest) -> int:
        """The number of a client's last goal, as far as is known; 0: none."""
        numbers = self._accepted.get(request.by)
        last = numbers[-1] if numbers else 0
        driven = self._memory.newest(Trajectory)
        if driven is None or orderer(driven) != by_name(request):
            return last
        # Another one that was accepted before, or a mission of the board, is not the last goal.
        untold = not last or self._is_unknown(driven, request)
        return self.number_of(driven) if untold else last

    def driven_for(self, request: AssistantRequest) -> int:
        """The number of a client's goal if it is under way, as far as is known; 0: it is not."""
        driven, mine = self._memory.newest(Trajectory), self.of(request)
        under_way = driven is not None and driven.waypoints and self.number_of(driven) == mine
        return mine if under_way else 0

    def lose(self, request: AssistantRequest) -> int:
        """Note that a client cancels a goal that no agent has answered.

        Returns its number if it is driven already; 0: see `found`.
        """
        driven = self._memory.newest(Trajectory)
        if driven is not None and self._is_unknown(driven, request):
            return driven.mission
        self._lost[by_name(request)] = request
        for each in [*self._lost][:-CLIENTS]:
            del self._lost[each]
        return 0

    def begin(self, request: AssistantRequest) -> None:
        """Note that a client has another goal: what is driven for it is not the lost one."""
        self._lost.pop(by_name(request), None)

    def found(self, trajectory: Trajectory) -> AssistantRequest | None:
        """The request that cancels a lost goal, if it is driven now."""
        request = self._lost.get(orderer(trajectory))
        if request is None or not self._is_unknown(trajectory, request):
            return None
        return self._lost.pop(orderer(trajectory))

    def _is_unknown(self, driven: Trajectory, request: AssistantRequest) -> bool:
        """Whether a goal of a client is driven, and no reply has told its number."""
        own = bool(driven.waypoints) and orderer(driven) == by_name(request)
        told = driven.mission in self._accepted.get(request.by, ())
        return own and not told and self.number_of(driven) == driven.mission

    def listed(self) -> Iterator[Progress]:
        """All missions on the boards of mission agents."""
        for each in self._memory.all():
            if isinstance(each, Errands):
                yield from each.errands

    def number_of(self, trajectory: Trajectory) -> int:
        """The number of the mission of a client that a path is driven for."""
        by = orderer(trajectory)
        listed = (each.number for each in self.listed() if each.active and each.by == by)
        return next(listed, trajectory.mission)


def client_in(by: str) -> str:
    """The client's name in the name of a mission, by which its rules are found at any time."""
    return by.removeprefix(f"{BY}: ")


def orderer(trajectory: Trajectory) -> str:
    """Who ordered the mission that a path is driven for; terms are of programs' missions alone."""
    return trajectory.by if trajectory.terms is None else trajectory.terms.by


def by_name(request: AssistantRequest) -> str:
    """The name under which a client's missions are ordered."""
    return line(f"{BY}: {request.by or 'a program'}")[:LONGEST_BY]
