"""The board: waiting missions, the active one, and those that are over. Sans-IO.

A mission that is more urgent than the active one suspends it; that goes on afterwards (use case 1
of thesis 3.2.1). The board is one message, so that it outlives mission planning.
"""

from __future__ import annotations

import zlib
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

from msgspec.structs import replace

from armadico.agents.interface.messages import MissionOrder
from armadico.agents.missions import procedures
from armadico.agents.missions.messages import Board, BoardMission, MissionEnd
from armadico.agents.missions.mission_file import LONGEST, Mission, read_mission
from armadico.config.places import Places
from armadico.core.config_errors import ConfigError
from armadico.core.messages import MessageError, encode, line

UNFINISHED_MOST: Final = 12  # missions that wait or are active; one more is refused

# Finished missions that stay on the board. As many as unfinished ones, so that each end is
# published at least once even if all are cancelled together.
FINISHED_MOST: Final = UNFINISHED_MOST

AHEAD_MOST: Final = 16  # next steps of a mission that are published

# Bytes of the deflated texts of all unfinished missions; results and frames fit beside them.
TEXTS_MOST: Final = 24_000

# Results published of each mission that is over, and of each other; the first pair that fits.
RESULTS_MOST: Final = ((100, 100), (10, 100), (0, 50), (0, 10), (0, 0))

NOTE_MOST: Final = 200  # characters of the note why a mission ended


def _cut(listed: BoardMission, most: int) -> BoardMission:
    """Return a mission with its newest results only."""
    results = listed.course.results
    if len(results) <= most:
        return listed
    newest = results[len(results) - most :]
    return replace(listed, course=replace(listed.course, results=newest))


class RefusedError(ValueError):
    """A mission is refused; the text is the reason."""


@dataclass
class Entry:
    """One mission: its row on the board, and the parsed mission; None if it is over."""

    listed: BoardMission
    mission: Mission | None

    @property
    def goes_on(self) -> bool:
        """Whether it waits or is active."""
        return self.mission is not None and not self.listed.over


def text_of(packed: bytes) -> str:
    """Return a deflated mission's text. Raises ConfigError."""
    try:
        unpacker = zlib.decompressobj()
        data = unpacker.decompress(packed, 4 * LONGEST)
        if unpacker.unconsumed_tail:
            raise ConfigError(f"its text has more than {LONGEST:,} characters")
        return data.decode()
    except (zlib.error, UnicodeDecodeError):
        raise ConfigError("its text cannot be read: deflated UTF-8 is expected") from None


class Missions:
    """All known missions, in the order of their arrival."""

    def __init__(self, places: Places) -> None:
        self._places = places
        self.entries: dict[int, Entry] = {}

    def propose(self, number: int, order: MissionOrder, start: tuple[float, float] | None) -> Entry:
        """Add a mission as the last one of its priority. Raises RefusedError."""
        if sum(entry.goes_on for entry in self.entries.values()) >= UNFINISHED_MOST:
            raise RefusedError(f"{UNFINISHED_MOST} missions wait already; cancel one")
        try:
            mission = read_mission(text_of(order.text), order.name, self._places, start)
        except ConfigError as error:
            raise RefusedError(str(error)) from None
        priority = mission.priority if order.priority is None else order.priority
        listed = BoardMission(
            *(number, order.name, priority, MissionEnd.QUEUED, order.by),
            text=order.text,
            terms=order.terms,
        )
        going_on = [entry.listed.text for entry in self.entries.values() if entry.goes_on]
        if sum(map(len, [*going_on, order.text])) > TEXTS_MOST:
            raise RefusedError("the board is full, so the mission cannot be published; cancel one")
        entry = self.entries[number] = Entry(listed, mission)
        return entry

    def cancel(self, number: int) -> list[Entry]:
        """Cancel a mission, or all with 0; return those that were unfinished."""
        chosen = self.entries.values() if number == 0 else [self.entries.get(number)]
        found = [entry for entry in chosen if entry is not None and entry.goes_on]
        for entry in found:
            self.end(entry, MissionEnd.CANCELLED, "")
        return found

    def end(self, entry: Entry, state: MissionEnd, note: str) -> None:
        """End a mission; the oldest of those that are over is removed."""
        entry.listed = replace(
            entry.listed,
            state=state,
            note=line(note)[:NOTE_MOST],
            text=b"",
            doing="",
            room="",
            ahead=(),
        )
        entry.mission = None
        if self.entries.pop(entry.listed.mission, None) is entry:
            self.entries[entry.listed.mission] = entry  # moves it to the end: sorted by end
        over = [number for number, each in self.entries.items() if not each.goes_on]
        for number in over[:-FINISHED_MOST]:
            del self.entries[number]

    @property
    def active(self) -> Entry | None:
        """The active mission."""
        return next((e for e in self.entries.values() if e.listed.state is MissionEnd.ACTIVE), None)

    def choose(self) -> Entry | None:
        """Return the mission to be done now: the most urgent; of equals, the one begun first."""
        going_on = [entry for entry in self.entries.values() if entry.goes_on]
        best = max((entry.listed.priority for entry in going_on), default=0.0)
        urgent = [entry for entry in going_on if entry.listed.priority == best]
        begun = [entry for entry in urgent if entry.listed.state is not MissionEnd.QUEUED]
        return next(iter(begun or urgent), None)

    def board(self, board: Board) -> Board:
        """Return the board with all missions, unfinished ones first.

        What does not fit into a message is left out: the oldest results, of finished missions
        first, and at last the next steps, which only people need.
        """
        listed = sorted(self.entries.values(), key=lambda entry: not entry.goes_on)
        for over, others in RESULTS_MOST:
            missions = tuple(_cut(e.listed, others if e.goes_on else over) for e in listed)
            found = replace(board, missions=missions)
            with suppress(MessageError):
                encode(found)
                return found
        return replace(found, missions=tuple(replace(m, ahead=()) for m in found.missions))

    def show(self, entry: Entry, room: str) -> None:
        """Update the current step, the room and the next steps of a mission."""
        mission, course = entry.mission, entry.listed.course
        if mission is None or not course.frames:
            return
        step = procedures.doing(mission, course)
        ahead = [line(str(each)) for each in procedures.ahead(mission, course)[:AHEAD_MOST]]
        doing = "" if step is None else line(str(step))
        entry.listed = replace(entry.listed, doing=doing, room=room, ahead=tuple(ahead))

    def learn(self, board: Board) -> None:
        """Take over a board of peers; unfinished missions that are not on it stay."""
        known, self.entries = self.entries, {}
        for listed in board.missions:
            mission = None
            if not listed.over:
                try:
                    mission = read_mission(text_of(listed.text), listed.name)
                except ConfigError as error:
                    listed = replace(listed, state=MissionEnd.FAILED, note=line(str(error)))  # noqa: PLW2901
            self.entries[listed.mission] = Entry(listed, mission)
        for number, entry in known.items():
            if number not in self.entries and entry.goes_on:
                self.entries[number] = entry
