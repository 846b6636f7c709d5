"""The board: missions that wait, the one that is done, and those that are over. Sans-IO.

Whoever proposes one that is more urgent than the active one suspends that; it goes on afterwards
(use case 1 of thesis 3.2.1). All of it is one message, so that it outlives mission planning.
"""

from __future__ import annotations

import zlib
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

from msgspec.structs import replace

from armadico.agents.missions import procedures
from armadico.agents.missions.messages import Board, BoardMission, MissionEnd, MissionOrder
from armadico.agents.missions.mission_file import LONGEST, Mission, read_mission
from armadico.config.errors import ConfigError
from armadico.config.places import Places
from armadico.core.messages import MessageError, encode, line

UNFINISHED_MOST: Final = 12
"""Missions that wait or are done; one more is refused."""

FINISHED_MOST: Final = UNFINISHED_MOST
"""Missions that are over and still told of, those that ended last: each one's end is told at least
once, though all that wait are cancelled together."""

AHEAD_TOLD: Final = 16
"""Steps to come that are told of."""

TEXTS_MOST: Final = 24_000
"""Bytes of the texts of all missions that go on, deflated: results and frames fit beside them."""

RESULTS_TOLD: Final = ((100, 100), (10, 100), (0, 50), (0, 10), (0, 0))
"""So many results of each mission that is over, and of each that goes on: the first that fit."""

NOTE_MOST: Final = 200
"""Characters that are kept of why a mission ended."""


def _cut(told: BoardMission, most: int) -> BoardMission:
    """A mission with its newest results only."""
    results = told.course.results
    if len(results) <= most:
        return told
    newest = results[len(results) - most :]
    return replace(told, course=replace(told.course, results=newest))


class RefusedError(ValueError):
    """A mission that is not taken on; the text is the reason."""


@dataclass
class Entry:
    """One mission: what is told of it, and what it was read as; None: it is over."""

    told: BoardMission
    mission: Mission | None

    @property
    def goes_on(self) -> bool:
        """Whether it waits, or is done."""
        return self.mission is not None and not self.told.over


def text_of(packed: bytes) -> str:
    """A mission's text as it was deflated. Raises ConfigError."""
    try:
        unpacker = zlib.decompressobj()
        data = unpacker.decompress(packed, 4 * LONGEST)
        if unpacker.unconsumed_tail:
            raise ConfigError(f"its text has more than {LONGEST:,} characters")
        return data.decode()
    except (zlib.error, UnicodeDecodeError):
        raise ConfigError("its text cannot be read: deflated UTF-8 is expected") from None


class Missions:
    """All missions that are known, in the order in which they came."""

    def __init__(self, places: Places) -> None:
        self._places = places
        self.entries: dict[int, Entry] = {}

    def propose(self, number: int, order: MissionOrder, start: tuple[float, float] | None) -> Entry:
        """Take a mission on as the last one of its priority. Raises RefusedError."""
        if sum(entry.goes_on for entry in self.entries.values()) >= UNFINISHED_MOST:
            raise RefusedError(f"{UNFINISHED_MOST} missions wait already; cancel one")
        try:
            mission = read_mission(text_of(order.text), order.name, self._places, start)
        except ConfigError as error:
            raise RefusedError(str(error)) from None
        priority = mission.priority if order.priority is None else order.priority
        told = BoardMission(
            number, order.name, priority, MissionEnd.QUEUED, order.by, text=order.text
        )
        going_on = [entry.told.text for entry in self.entries.values() if entry.goes_on]
        if sum(map(len, [*going_on, order.text])) > TEXTS_MOST:
            raise RefusedError("the board is full: nobody could be told of it; cancel one")
        entry = self.entries[number] = Entry(told, mission)
        return entry

    def cancel(self, number: int) -> list[Entry]:
        """Cancel a mission, or all with 0; those that were going on."""
        chosen = self.entries.values() if number == 0 else [self.entries.get(number)]
        found = [entry for entry in chosen if entry is not None and entry.goes_on]
        for entry in found:
            self.end(entry, MissionEnd.CANCELLED, "")
        return found

    def end(self, entry: Entry, state: MissionEnd, note: str) -> None:
        """A mission is over; the oldest of those that are is forgotten."""
        entry.told = replace(
            entry.told,
            state=state,
            note=line(note)[:NOTE_MOST],
            text=b"",
            doing="",
            room="",
            ahead=(),
        )
        entry.mission = None
        if self.entries.pop(entry.told.mission, None) is entry:
            self.entries[entry.told.mission] = entry  # in the order in which they ended
        over = [number for number, each in self.entries.items() if not each.goes_on]
        for number in over[:-FINISHED_MOST]:
            del self.entries[number]

    @property
    def active(self) -> Entry | None:
        """The one that is done."""
        return next((e for e in self.entries.values() if e.told.state is MissionEnd.ACTIVE), None)

    def choose(self) -> Entry | None:
        """The one to be done now: the most urgent, of those the one that was begun first."""
        going_on = [entry for entry in self.entries.values() if entry.goes_on]
        best = max((entry.told.priority for entry in going_on), default=0.0)
        urgent = [entry for entry in going_on if entry.told.priority == best]
        begun = [entry for entry in urgent if entry.told.state is not MissionEnd.QUEUED]
        return next(iter(begun or urgent), None)

    def board(self, board: Board) -> Board:
        """All of it, as it is told: those that go on first.

        What would not fit into a message is left out: of results the oldest, of those first that
        are over, and at last the steps to come, which are for people.
        """
        told = sorted(self.entries.values(), key=lambda entry: not entry.goes_on)
        for over, others in RESULTS_TOLD:
            missions = tuple(_cut(e.told, others if e.goes_on else over) for e in told)
            found = replace(board, missions=missions)
            with suppress(MessageError):
                encode(found)
                return found
        return replace(found, missions=tuple(replace(m, ahead=()) for m in found.missions))

    def show(self, entry: Entry, room: str) -> None:
        """Bring up to date what is told of a mission for people."""
        mission, course = entry.mission, entry.told.course
        if mission is None or not course.frames:
            return
        step = procedures.doing(mission, course)
        ahead = [line(str(each)) for each in procedures.ahead(mission, course)[:AHEAD_TOLD]]
        doing = "" if step is None else line(str(step))
        entry.told = replace(entry.told, doing=doing, room=room, ahead=tuple(ahead))

    def learn(self, board: Board) -> None:
        """Take what others remember; missions of one's own that are not on it stay."""
        known, self.entries = self.entries, {}
        for told in board.missions:
            mission = None
            if not told.over:
                try:
                    mission = read_mission(text_of(told.text), told.name)
                except ConfigError as error:
                    told = replace(told, state=MissionEnd.FAILED, note=line(str(error)))  # noqa: PLW2901
            self.entries[told.mission] = Entry(told, mission)
        for number, entry in known.items():
            if number not in self.entries and entry.goes_on:
                self.entries[number] = entry
